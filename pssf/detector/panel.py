"""The panel: gain, readout noise, offset, 16-bit numbers."""

import numpy as np
from numpy.typing import NDArray

from ..xray.technique import Technique
from .noise import Map, in_bands

# Value of a saturated pixel, DN.
MOST_DN = 65535


def readout(
    kev: Map, technique: Technique, seed: np.random.SeedSequence | None, workers: int = 2
) -> NDArray[np.uint16]:
    """(rows, cols) uint16  gain, readout noise (Gaussian, electrons), offset, saturation, dead pixels

    A larger pixel holds charge in proportion to its area.
    kev   (rows, cols)  energy absorbed, keV a pixel
    seed  of the noise; None for none
    """
    detector, protocol = technique.detector, technique.protocol
    electrons = kev * np.float32(detector.electrons_per_kev)
    # In place: a fresh large array costs more time than the arithmetic.
    if seed is not None:
        noise = in_bands(
            kev.shape,
            seed,
            lambda rng, rows: rng.standard_normal((rows.stop - rows.start, kev.shape[1]), np.float32),
            workers,
        )
        noise *= np.float32(detector.readout_electrons)
        electrons += noise
    electrons /= np.float32(detector.electrons_per_dn_mm2 * protocol.pixel_mm**2)
    electrons += np.float32(detector.offset_dn)
    np.rint(electrons, out=electrons)
    pixels = np.clip(electrons, 0, MOST_DN, out=electrons).astype(np.uint16)
    if protocol.dead_pixels:
        pixels[dead_pixels(technique)] = 0
    return pixels


def dead_pixels(technique: Technique) -> NDArray[np.bool_]:
    """(rows, cols)  which pixels of a technique's detector read nothing; the same in every exposure"""
    protocol, rng = technique.protocol, np.random.default_rng(technique.detector.dead_seed)
    return rng.random((protocol.rows, protocol.cols)) < protocol.dead_pixels
