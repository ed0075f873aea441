"""Measure detector quality as in a laboratory: slanted-edge MTF, NPS of flat fields, DQE and photon transfer."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..detector.detector_blur import compute_transfer
from ..detector.panel_readout import linearise_pixels
from ..detector.quantum_noise import GAUSSIAN_MIN_QUANTA
from ..stages import LatentImage, StageContext, run_stages
from ..xray.materials import attenuation_per_mm, parse_compound
from ..xray.resolved_technique import Technique
from ..xray.spectrum import compute_beam
from .image_quality import average_over_rings, compute_edge_mtf, measure_flat_nnps, ring_frequencies_per_mm

# Angle between the edge of the lead plate and the pixel columns, in degrees (IEC 62220-1: 1.5 to 3).
_EDGE_DEG = 2.4
# Number of rows and columns of the edge image.
_EDGE_PX = 512
# Side length of a region of interest for the noise power spectrum, in pixels.
_ROI_PX = 128
# Number of regions of interest along each side of a flat field.
_ROIS = 4
# Number of flat-field exposures.
_FIELDS = 6


@dataclass(frozen=True)
class FrequencyCurve:
    """Measured and model values of a quantity as a function of spatial frequency.

    Attributes
    ----------
    frequency_per_mm : (n,) array
        Spatial frequencies, in cycles per mm.
    measured : (n,) array
        Measured values.
    model : (n,) array
        Values predicted by the detector model.
    """

    frequency_per_mm: Array
    measured: Array
    model: Array


def make_bare_technique(technique: Technique, side_px: int) -> Technique:
    """Make a technique with a square detector and a point source, and without objects in the beam.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    side_px : int
        Number of rows and columns of the detector.

    Returns
    -------
    Technique
        Technique without focal-spot blur, scatter, heel effect, dead pixels, collimator or side marker.
    """
    return technique.replace_protocol(
        rows=side_px,
        cols=side_px,
        focal_spot_mm=0.0,
        subpixels=1,
        scatter="none",
        heel="none",
        dead_pixels=0.0,
        field_width_mm=0.0,
        field_height_mm=0.0,
        marker="none",
    )


def model_mtf(technique: Technique, per_mm: Array) -> Array:
    """Compute the presampled MTF of the detector model.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    per_mm : (n,) array
        Spatial frequencies, in cycles per mm.

    Returns
    -------
    (n,) array
        MTF, dimensionless; 1 everywhere if the protocol has no detector blur.
    """
    if technique.protocol.detector_blur == "none":
        return np.ones_like(per_mm)
    return compute_transfer(technique.detector, per_mm)


def measure_mtf(technique: Technique) -> FrequencyCurve:
    """Measure the presampled MTF with a slanted edge, without noise (Samei 1998).

    A lead plate with a straight edge is on the detector. The edge spread function is differentiated to the line spread
    function, whose Fourier transform is the MTF. Pixels that the edge crosses are partly open, which adds one pixel
    aperture to the simulated signal. The transfer function of this aperture is divided out.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    FrequencyCurve
        Presampled MTF up to the Nyquist frequency.
    """
    quiet = make_bare_technique(technique, _EDGE_PX).replace_protocol(
        noise="none", mono_kev=60.0, filters=(), spectrum=None, mas=_monoenergetic_mas(technique)
    )
    pixel_mm = technique.protocol.pixel_mm
    rows, cols = np.mgrid[:_EDGE_PX, :_EDGE_PX] - (_EDGE_PX - 1) / 2
    across = cols * np.cos(np.deg2rad(_EDGE_DEG)) + rows * np.sin(np.deg2rad(_EDGE_DEG))
    # The path length in lead is chosen so that the transmission equals the uncovered fraction of the pixel.
    per_mm = float(attenuation_per_mm(parse_compound("Pb@11.35"), np.array([60.0]))[0])
    path = -np.log(np.clip(0.5 - across, 1e-6, 1.0)) / per_mm
    pixels = _require_pixels(_expose_paths({"Pb@11.35": path.astype(np.float32)}, quiet))
    middle = slice(_EDGE_PX // 8, -_EDGE_PX // 8)
    frequency, measured = compute_edge_mtf(pixels[middle, middle].astype(np.float64), across[middle, middle], pixel_mm)
    measured /= np.sinc(frequency * pixel_mm)
    return FrequencyCurve(frequency, measured, model_mtf(technique, frequency))


def _monoenergetic_mas(technique: Technique) -> float:
    """Compute the mAs at which a monoenergetic beam gives a signal near the middle of the 16-bit range."""
    trial = make_bare_technique(technique, 8).replace_protocol(
        noise="none", mono_kev=60.0, filters=(), spectrum=None, mas=1.0
    )
    return 30000.0 / max(float(_require_pixels(_expose_paths({}, trial)).mean()) - technique.detector.offset_dn, 1.0)


def simulate_flat_fields(technique: Technique, count: int = _FIELDS) -> Array:
    """Simulate flat-field exposures with the open beam.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    count : int, default 6
        Number of exposures with independent noise.

    Returns
    -------
    (count, rows, cols) array
        Linear pixel values minus the detector offset, in DN.
    """
    side = _ROI_PX * _ROIS
    flat = make_bare_technique(technique, side)
    images = [_require_pixels(_expose_paths({}, flat, seed=number)) for number in range(count)]
    return linearise_pixels(np.array(images), technique.detector).astype(np.float64)


def measure_nnps(technique: Technique) -> FrequencyCurve:
    """Measure the normalised noise power spectrum of flat fields, averaged over directions (IEC 62220-1).

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    FrequencyCurve
        Normalised noise power spectrum, in mm2.
    """
    fields, pixel_mm = simulate_flat_fields(technique), technique.protocol.pixel_mm
    frequency, measured = measure_flat_nnps(fields, pixel_mm)
    meant = model_nnps(technique, ring_frequencies_per_mm(pixel_mm), float(fields.mean()))
    return FrequencyCurve(frequency, measured, average_over_rings(meant, pixel_mm)[1])


def model_nnps(technique: Technique, per_mm: Array, mean_dn: float) -> Array:
    """Compute the normalised noise power spectrum of the detector model.

    The spectrum is the sum of filtered quantum noise, readout noise and rounding noise.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    per_mm : (...) array
        Spatial frequencies, in cycles per mm.
    mean_dn : float
        Mean signal after subtraction of the offset, in DN.

    Returns
    -------
    (...) array
        Normalised noise power spectrum, in mm2.
    """
    protocol, detector, beam = technique.protocol, technique.detector, compute_beam(technique)
    per_dn = detector.electrons_per_dn_mm2 * protocol.pixel_mm**2
    weights = beam.photons_per_mm2 * beam.signal_kev
    quantum_kev = (beam.photons_per_mm2 * beam.square_kev2).sum() / weights.sum() / detector.swank
    quanta = mean_dn * per_dn / detector.electrons_per_kev / quantum_kev
    readout = (detector.readout_electrons / per_dn) ** 2 + 1 / 12
    blurred = protocol.detector_blur != "none"
    passed = compute_transfer(detector, per_mm, "ntf") ** 2 if blurred else np.ones_like(per_mm)
    noise = passed / quanta + readout / mean_dn**2
    return np.asarray(noise * protocol.pixel_mm**2)


def measure_dqe(technique: Technique) -> FrequencyCurve:
    """Measure the detective quantum efficiency (DQE), MTF^2 / (NNPS q), in the open beam of a protocol.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    FrequencyCurve
        DQE, dimensionless. In the formula, q is the number of photons per mm2 at the detector.
    """
    noise, sharp = measure_nnps(technique), measure_mtf(technique)
    q = compute_beam(technique).photons_per_mm2.sum() * (1000.0 / technique.protocol.sdd_mm) ** 2
    at = np.interp(noise.frequency_per_mm, sharp.frequency_per_mm, sharp.measured)
    meant = model_mtf(technique, noise.frequency_per_mm) ** 2
    return FrequencyCurve(noise.frequency_per_mm, at**2 / (noise.measured * q), meant / (noise.model * q))


def measure_photon_transfer(technique: Technique, steps: int = 6) -> list[tuple[float, float, float]]:
    """Measure the variance of flat fields without detector blur as a function of mAs.

    Parameters
    ----------
    technique : Technique
        Resolved protocol, whose mAs is the highest simulated value.
    steps : int, default 6
        Number of mAs values, from 1/64 of the protocol mAs to the full protocol mAs.

    Returns
    -------
    list of (mean, measured, model) tuple of float
        Mean in DN, measured variance and model variance in DN2, for each mAs value.
    """
    rows = []
    for mas in technique.protocol.mas * np.geomspace(1 / 64, 1.0, steps):
        sharp = technique.replace_protocol(mas=float(mas), detector_blur="none")
        one, other = simulate_flat_fields(sharp, 2)
        mean = float((one.mean() + other.mean()) / 2)
        meant = float(model_nnps(sharp, np.zeros(1), mean)[0]) / technique.protocol.pixel_mm**2 * mean**2
        rows.append((mean, float((one - other).var() / 2), meant))
    return rows


def measure_noise_moments(technique: Technique) -> dict[str, tuple[float, float, float]]:
    """Measure mean, variance and skewness of the noise in a flat field without detector blur.

    The mean and the variance are normalised by the standard deviation and the variance of the model.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    dict of str to (value, low, high) tuple of float
        Measured moments, with an expected range of four standard errors for the number of pixels.
    """
    flat = make_bare_technique(technique, _ROI_PX * _ROIS).replace_protocol(detector_blur="none")
    image, offset = _expose_paths({}, flat, seed=9, keep=frozenset({"noise_free"})), flat.detector.offset_dn
    pixels, mean = _require_pixels(image), image.kept["noise_free"].astype(np.float64) - offset
    variance = model_nnps(flat, np.zeros(1), mean) / flat.protocol.pixel_mm**2 * mean**2
    off, n = (pixels - offset - mean) / np.sqrt(variance), pixels.size
    # The expected skewness is that of Poisson counts, or 0 for large counts sampled from a normal distribution.
    quanta = float(np.mean(mean**2 / variance))
    skewness = 1 / np.sqrt(quanta) if quanta < GAUSSIAN_MIN_QUANTA else 0.0
    shape = (off - off.mean()) / off.std()
    moments = {
        "mean": (off.mean(), 0.0, 1),
        "variance": (off.var(), 1.0, 2),
        "skewness": (np.mean(shape**3), skewness, 6),
        "kurtosis": (np.mean(shape**4), 3.0, 24),
    }
    return {
        f"noise_{name}": (float(value), about - 4 * np.sqrt(var / n), about + 4 * np.sqrt(var / n))
        for name, (value, about, var) in moments.items()
    }


def _expose_paths(
    path_mm: Mapping[str, NDArray[np.float32]], technique: Technique, seed: int = 0, keep: frozenset[str] = frozenset()
) -> LatentImage:
    """Run the imaging stages for path lengths (rows, cols), in mm, without a scene."""
    image = LatentImage(path_mm=path_mm)
    run_stages(image, StageContext(technique=technique, seed=seed, keep=keep))
    return image


def _require_pixels(image: LatentImage) -> NDArray[np.uint16]:
    """Return the pixels of an image after all imaging stages."""
    assert image.pixels is not None
    return image.pixels
