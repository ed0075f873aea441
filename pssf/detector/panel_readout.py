"""Detector readout: gain, readout noise, offset and conversion to 16-bit pixel values."""

import numpy as np
from numpy.typing import NDArray

from ..xray.resolved_technique import Technique
from .quantum_noise import Map, sample_in_bands

# Value of a saturated pixel, in DN.
MAX_DN = 65535


def simulate_readout(
    kev: Map, technique: Technique, seed: np.random.SeedSequence | None, workers: int = 2
) -> NDArray[np.uint16]:
    """Convert absorbed energy to pixel values: gain, readout noise, offset, saturation and dead pixels.

    Parameters
    ----------
    kev : (rows, cols) float32 array, keV
        Absorbed energy per pixel.
    technique : Technique
        Resolved protocol.
    seed : numpy.random.SeedSequence or None
        Seed of the Gaussian readout noise; None to omit readout noise.
    workers : int, default 2
        Number of threads, which does not affect the result.

    Returns
    -------
    (rows, cols) uint16 array
        Pixel values in DN. The charge per DN is proportional to the pixel area.
    """
    detector, protocol = technique.detector, technique.protocol
    electrons = kev * np.float32(detector.electrons_per_kev)
    # The values are computed in place, because allocating a new large array takes longer than the arithmetic.
    if seed is not None:
        noise = sample_in_bands(
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
    pixels = np.clip(electrons, 0, MAX_DN, out=electrons).astype(np.uint16)
    if protocol.dead_pixels:
        pixels[sample_dead_pixels(technique)] = 0
    return pixels


def sample_dead_pixels(technique: Technique) -> NDArray[np.bool_]:
    """Sample the locations of the dead pixels of a detector; the locations are the same in every exposure.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    (rows, cols) bool array
        True for dead pixels.
    """
    protocol, rng = technique.protocol, np.random.default_rng(technique.detector.dead_seed)
    return rng.random((protocol.rows, protocol.cols)) < protocol.dead_pixels
