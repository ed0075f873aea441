"""Detector readout: gain, readout noise, offset and conversion to 16-bit pixel values."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.detector import Detector
from ..xray.resolved_technique import Technique
from .quantum_noise import Map, sample_in_bands

# Spawn key of the random stream for the gains of the pixels, combined with the seed of the panel.
_GAIN_STREAM = 1


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
    if detector.gain_variation:
        electrons *= sample_pixel_gains(technique)
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
    if detector.response is not None:
        electrons = _apply_response(electrons, detector)
    electrons += np.float32(detector.offset_dn)
    np.rint(electrons, out=electrons)
    pixels = np.clip(electrons, 0, detector.saturation_dn, out=electrons).astype(np.uint16)
    if protocol.dead_pixels:
        pixels[sample_dead_pixels(technique)] = 0
    return pixels


def _apply_response(linear_dn: Map, detector: Detector) -> Map:
    """Apply the response curve of a detector (rows, cols) in DN; negative values, which are noise, stay linear."""
    linear, recorded = np.array(detector.response, np.float64).T
    return np.where(linear_dn > 0, np.interp(linear_dn, linear, recorded), linear_dn).astype(np.float32)


def linearise_pixels(pixels: NDArray[Any], detector: Detector) -> NDArray[np.float32]:
    """Convert pixel values to values that are proportional to the absorbed energy.

    Parameters
    ----------
    pixels : (...) array, DN
        Pixel values.
    detector : Detector
        Detector with offset and response curve.

    Returns
    -------
    (...) float32 array
        Pixel values minus offset, in DN, without the response curve.
    """
    above = pixels.astype(np.float32) - np.float32(detector.offset_dn)
    if detector.response is None:
        return above
    linear, recorded = np.array(detector.response, np.float64).T
    return np.where(above > 0, np.interp(above, recorded, linear), above).astype(np.float32)


def sample_pixel_gains(technique: Technique) -> Map:
    """Sample the relative gain of each pixel of a panel; it is the same in every exposure.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    (rows, cols) float32 array
        Gains with mean 1, dimensionless, and not negative.
    """
    detector, protocol = technique.detector, technique.protocol
    rng = np.random.default_rng(np.random.SeedSequence(detector.dead_seed, spawn_key=(_GAIN_STREAM,)))
    gains = rng.standard_normal((protocol.rows, protocol.cols), np.float32)
    return np.maximum(1 + np.float32(detector.gain_variation) * gains, 0)


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
