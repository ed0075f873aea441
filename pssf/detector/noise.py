"""Quantum noise, and the streams that noise is drawn from."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float32]
# Quanta in a pixel from which on a normal distribution is exact enough.
GAUSSIAN_FROM = 4096
_BAND_ROWS = 256


def quantum_noise(kev: Map, photon_kev: Map, swank: float, seed: np.random.SeedSequence, workers: int = 2) -> Map:
    """(rows, cols)  energy absorbed in one exposure, keV: mean `kev`, variance kev * photon_kev / Swank

    A compound Poisson sum of photons is drawn as a Poisson count of effective quanta of equal energy, so that mean and
    variance are those of the polychromatic beam (Swank 1973). Above GAUSSIAN_FROM quanta the count is normal: what is
    lost is a skewness of less than 0.016, a thousandth in the distribution's cumulated share (Edgeworth).
    kev         (rows, cols)  mean
    photon_kev  (rows, cols)  mean square over mean energy of an absorbed photon
    swank       factor of the detector
    workers     threads; bands of rows own their streams, so the result does not depend on them
    """

    def draw(rng: np.random.Generator, rows: slice) -> Map:
        quantum = photon_kev[rows] / np.float32(swank)
        mean = np.divide(kev[rows], quantum, out=np.zeros_like(quantum), where=quantum > 0)
        many = mean > GAUSSIAN_FROM
        few, count = ~many, np.empty_like(mean)
        count[few] = rng.poisson(mean[few])
        mean = mean[many]
        count[many] = mean + np.sqrt(mean) * rng.standard_normal(len(mean), np.float32)
        count *= quantum
        return count

    return in_bands(kev.shape, seed, draw, workers)


def in_bands(
    shape: tuple[int, ...],
    seed: np.random.SeedSequence,
    draw: Callable[[np.random.Generator, slice], Map],
    workers: int,
) -> Map:
    """(rows, cols)  drawn in bands of rows, each from a stream of its own, so that it does not depend on the threads"""
    starts = range(0, shape[0], _BAND_ROWS)
    result = np.empty(shape, np.float32)

    def fill(job: tuple[int, np.random.SeedSequence]) -> None:
        rows = slice(job[0], min(job[0] + _BAND_ROWS, shape[0]))
        result[rows] = draw(np.random.default_rng(job[1]), rows)

    # Children by key, not by spawn(), which would count up a seed that is used twice.
    children = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(len(starts))]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, zip(starts, children, strict=True)))
    return result
