"""Sampling of quantum noise, in bands of image rows with separate random streams."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float32]
# Number of quanta per pixel above which a normal distribution replaces the Poisson distribution.
GAUSSIAN_MIN_QUANTA = 4096
# Number of image rows in a band; each band has a separate random stream.
_BAND_ROWS = 256


def sample_quantum_noise(
    kev: Map, photon_kev: Map, swank: float, seed: np.random.SeedSequence, workers: int = 2
) -> Map:
    """Sample the energy absorbed in one exposure, with mean `kev` and variance kev x photon_kev / swank.

    Parameters
    ----------
    kev : (rows, cols) float32 array, keV
        Mean absorbed energy per pixel.
    photon_kev : (rows, cols) float32 array, keV
        Mean squared energy divided by mean energy of the absorbed photons.
    swank : float
        Swank factor of the detector, from 0 to 1.
    seed : numpy.random.SeedSequence
        Seed of the noise.
    workers : int, default 2
        Number of threads, which does not affect the result, because each band of rows has a separate random stream.

    Returns
    -------
    (rows, cols) float32 array
        Sampled energy per pixel, in keV.

    Notes
    -----
    The energy sum of a Poisson number of photons with various energies is sampled as a Poisson number of effective
    quanta of equal energy. Mean and variance are those of the polychromatic beam (Swank 1973). Above 4096 quanta, the
    number is sampled from a normal distribution. The normal distribution neglects a skewness below 0.016, which changes
    the cumulative distribution by at most 0.001 (Edgeworth).
    """

    def draw(rng: np.random.Generator, rows: slice) -> Map:
        quantum = photon_kev[rows] / np.float32(swank)
        mean = np.divide(kev[rows], quantum, out=np.zeros_like(quantum), where=quantum > 0)
        many = mean > GAUSSIAN_MIN_QUANTA
        few, count = ~many, np.empty_like(mean)
        count[few] = rng.poisson(mean[few])
        mean = mean[many]
        count[many] = mean + np.sqrt(mean) * rng.standard_normal(len(mean), np.float32)
        count *= quantum
        return count

    return sample_in_bands(kev.shape, seed, draw, workers)


def sample_in_bands(
    shape: tuple[int, ...],
    seed: np.random.SeedSequence,
    sample_band: Callable[[np.random.Generator, slice], Map],
    workers: int,
) -> Map:
    """Sample an image in bands of rows with separate random streams.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the image.
    seed : numpy.random.SeedSequence
        Seed from which the seeds of all bands are derived.
    sample_band : callable
        Function of a generator and a slice of rows that returns the sampled rows, (rows, cols) float32.
    workers : int
        Number of threads, which does not affect the result.

    Returns
    -------
    (rows, cols) float32 array
        Sampled image.
    """
    starts = range(0, shape[0], _BAND_ROWS)
    result = np.empty(shape, np.float32)

    def fill(job: tuple[int, np.random.SeedSequence]) -> None:
        rows = slice(job[0], min(job[0] + _BAND_ROWS, shape[0]))
        result[rows] = sample_band(np.random.default_rng(job[1]), rows)

    # The child seeds have explicit keys, because repeated calls of SeedSequence.spawn() return different seeds.
    children = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(len(starts))]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, zip(starts, children, strict=True)))
    return result
