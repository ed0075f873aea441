"""Spatial noise: sums of random plane waves, approximately normal and reproducible from a seed."""

from functools import lru_cache

import numpy as np

from ...core.checks import Array
from ...data.table_records import Pair

# Number of waves; their sum is approximately normally distributed.
_WAVE_COUNT = 32


def compute_wave_noise(points: Array, lengths_mm: Pair, seed: int, stream_key: tuple[int, ...]) -> Array:
    """Evaluate a spatial noise field with mean 0 and standard deviation 1.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points to evaluate.
    lengths_mm : (float, float)
        Shortest and longest wavelength, in mm; wavelengths are log-uniform in between.
    seed : int
        Seed of the random waves.
    stream_key : tuple of int
        Key of the random stream; fields with the same seed and different keys are independent.

    Returns
    -------
    (n,) float64 array
        Noise values, dimensionless.
    """
    steps, phases = _sample_waves(lengths_mm, seed, stream_key)
    waves = np.cos(points @ steps.T + phases)
    return np.asarray(waves.sum(axis=1) * np.sqrt(2 / _WAVE_COUNT))


# The waves are cached, because building one knee evaluates a few noise fields at about a hundred sets of points.
@lru_cache(maxsize=32)
def _sample_waves(lengths_mm: Pair, seed: int, stream_key: tuple[int, ...]) -> tuple[Array, Array]:
    """Sample the wave vectors (waves, 3), in rad/mm, and the phases at the origin (waves,), in rad."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=stream_key))
    ways = rng.standard_normal((_WAVE_COUNT, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    lengths = np.exp(rng.uniform(np.log(lengths_mm[0]), np.log(lengths_mm[1]), _WAVE_COUNT))
    return ways * (2 * np.pi / lengths)[:, None], rng.uniform(0, 2 * np.pi, _WAVE_COUNT)
