"""noise: places -> a sum of waves of random directions and lengths, about normal, the same for the same seed."""

from functools import lru_cache

import numpy as np

from ..core.checks import Array
from ..data.records import Pair

# So many that their sum is about normal.
_WAVES = 32


def noise(points: Array, lengths_mm: Pair, seed: int, key: tuple[int, ...]) -> Array:
    """(n,)  of mean 0 and standard deviation 1

    points      (n, 3)  mm
    lengths_mm  of the shortest and of the longest wave
    key         of what it is for, among all that has the seed
    """
    steps, phases = _waves(lengths_mm, seed, key)
    waves = np.cos(points @ steps.T + phases)
    return np.asarray(waves.sum(axis=1) * np.sqrt(2 / _WAVES))


# A knee asks for its few fields at a hundred sets of places.
@lru_cache(maxsize=32)
def _waves(lengths_mm: Pair, seed: int, key: tuple[int, ...]) -> tuple[Array, Array]:
    """Of each wave the phase's change along x, y and z, (waves, 3), 1/mm, and the phase at the origin, (waves,)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    ways = rng.standard_normal((_WAVES, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    lengths = np.exp(rng.uniform(np.log(lengths_mm[0]), np.log(lengths_mm[1]), _WAVES))
    return ways * (2 * np.pi / lengths)[:, None], rng.uniform(0, 2 * np.pi, _WAVES)
