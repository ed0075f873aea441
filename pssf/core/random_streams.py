"""Random generators that are independent of each other, by a seed and a key."""

import numpy as np


def make_stream(seed: int, *key: int) -> np.random.Generator:
    """Return the random generator for a seed and a key.

    Parameters
    ----------
    seed : int
        Seed.
    *key : int
        Key of the stream.

    Returns
    -------
    numpy.random.Generator
        Generator.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
