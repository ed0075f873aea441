"""The panel: quantum and readout noise, 16-bit numbers."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from ..data import tables
from ..model.protocol import Protocol

Map = NDArray[np.float32]
# Quanta in a pixel from which on a normal distribution is exact enough.
GAUSSIAN_FROM = 4096
_BAND_ROWS = 256


def quantum_noise(
    kev: Map, photon_kev: Map, seed: np.random.SeedSequence, workers: int = 2, detector: str = "csi"
) -> Map:
    """(rows, cols)  energy absorbed in one exposure, keV: mean `kev`, variance kev * photon_kev / Swank

    A compound Poisson sum of photons is drawn as a Poisson count of effective quanta of equal energy, so that mean and
    variance are those of the polychromatic beam (Swank 1973). Above GAUSSIAN_FROM quanta the count is normal: what is
    lost is a skewness of less than 0.016, a thousandth in the distribution's cumulated share (Edgeworth).
    photon_kev  (rows, cols)  mean square over mean energy of an absorbed photon
    workers     threads; bands of rows own their streams, so the result does not depend on them
    """
    swank = tables.data("detector")[detector]["swank"]

    def draw(rng: np.random.Generator, rows: slice) -> Map:
        quantum = photon_kev[rows] / np.float32(swank)
        mean = np.divide(kev[rows], quantum, out=np.zeros_like(quantum), where=quantum > 0)
        many = mean > GAUSSIAN_FROM
        count = rng.poisson(np.where(many, 0, mean)).astype(np.float32)
        count[many] = mean[many] + np.sqrt(mean[many]) * rng.standard_normal(np.count_nonzero(many), np.float32)
        return count * quantum

    return _in_bands(kev.shape, seed, draw, workers)


def readout(kev: Map, protocol: Protocol, seed: np.random.SeedSequence | None, workers: int = 2) -> NDArray[np.uint16]:
    """(rows, cols) uint16  gain, readout noise (Gaussian, electrons), offset, saturation, dead pixels

    A larger pixel holds charge in proportion to its area.
    seed  of the noise; None for none
    """
    table = tables.data("detector")[protocol.detector]
    electrons = kev * np.float32(table["electrons_per_kev"])
    if seed is not None:
        sigma = np.float32(table["readout_electrons"])
        electrons = electrons + sigma * _in_bands(
            kev.shape,
            seed,
            lambda rng, rows: rng.standard_normal((rows.stop - rows.start, kev.shape[1]), np.float32),
            workers,
        )
    per_dn = np.float32(table["electrons_per_dn_mm2"] * protocol.pixel_mm**2)
    pixels = np.clip(np.rint(electrons / per_dn + np.float32(table["offset_dn"])), 0, 65535).astype(np.uint16)
    if protocol.dead_pixels:
        pixels[dead_pixels(protocol)] = 0
    return pixels


def dead_pixels(protocol: Protocol) -> NDArray[np.bool_]:
    """(rows, cols)  which pixels of a protocol's detector read nothing; the same in every exposure"""
    rng = np.random.default_rng(tables.data("detector")[protocol.detector]["dead_seed"])
    return rng.random((protocol.rows, protocol.cols)) < protocol.dead_pixels


def _in_bands(
    shape: tuple[int, ...],
    seed: np.random.SeedSequence,
    draw: Callable[[np.random.Generator, slice], Map],
    workers: int,
) -> Map:
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
