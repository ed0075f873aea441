"""The detector measured as in a laboratory: MTF of a slanted edge, NPS of flat fields, DQE, photon transfer."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..detector.blur import transfer
from ..detector.noise import GAUSSIAN_FROM
from ..stages import Chain, LatentImage, expose
from ..xray.materials import attenuation_per_mm, compound_of
from ..xray.spectrum import beam_of
from ..xray.technique import Technique

# Slanted edge of a lead plate on the detector (IEC 62220-1: 1.5 to 3 degrees), bins a pixel, rows and columns.
_EDGE_DEG, _FINER, _EDGE_PX = 2.4, 8, 512
# Side of the regions of the noise power spectrum, regions a side of a flat field, and flat fields.
_ROI_PX, _ROIS, _FIELDS = 128, 4, 6


@dataclass(frozen=True)
class Curve:
    """A function of spatial frequency.

    per_mm    (n,)
    measured  (n,)
    model     (n,)  what the package means it to be
    """

    per_mm: Array
    measured: Array
    model: Array


def bare(technique: Technique, side_px: int) -> Technique:
    """The technique with a detector of a square of pixels, and nothing between it and a point source."""
    return technique.taken(
        rows=side_px,
        cols=side_px,
        focal_spot_mm=0.0,
        scatter="none",
        heel="none",
        dead_pixels=0.0,
        field_width_mm=0.0,
        field_height_mm=0.0,
        marker="none",
    )


def model_mtf(technique: Technique, per_mm: Array) -> Array:
    """(n,)  presampled MTF that the detector is made with

    per_mm  (n,)  cycles/mm
    """
    if technique.protocol.detector_blur == "none":
        return np.ones_like(per_mm)
    return transfer(technique.detector, per_mm)


def mtf(technique: Technique) -> Curve:
    """Presampled MTF from a slanted edge, without noise (Samei 1998): edge spread, line spread, its transform.

    A plate of lead with a straight edge lies on the detector; a pixel that the edge crosses is open in part, which is
    an aperture of a pixel more than point rays have, and is divided out again.
    """
    quiet = bare(technique, _EDGE_PX).taken(noise="none", mono_kev=60.0, mas=_mono_mas(technique))
    pixel_mm = technique.protocol.pixel_mm
    rows, cols = np.mgrid[:_EDGE_PX, :_EDGE_PX] - (_EDGE_PX - 1) / 2
    across = cols * np.cos(np.deg2rad(_EDGE_DEG)) + rows * np.sin(np.deg2rad(_EDGE_DEG))
    # The path in lead that lets as much pass as the open part of a pixel.
    per_mm = float(attenuation_per_mm(compound_of("Pb@11.35"), np.array([60.0]))[0])
    path = -np.log(np.clip(0.5 - across, 1e-6, 1.0)) / per_mm
    pixels = _pixels(_exposed({"Pb@11.35": path.astype(np.float32)}, quiet))
    middle = slice(_EDGE_PX // 8, -_EDGE_PX // 8)
    frequency, measured = _edge_mtf(pixels[middle, middle].astype(np.float64), across[middle, middle], pixel_mm)
    measured /= np.sinc(frequency * pixel_mm)
    return Curve(frequency, measured, model_mtf(technique, frequency))


def _mono_mas(technique: Technique) -> float:
    """mAs at one energy that give about the mid of the 16-bit range."""
    trial = bare(technique, 8).taken(noise="none", mono_kev=60.0, mas=1.0)
    return 30000.0 / max(float(_pixels(_exposed({}, trial)).mean()) - technique.detector.offset_dn, 1.0)


def _edge_mtf(pixels: Array, across: Array, pixel_mm: float) -> tuple[Array, Array]:
    """Frequencies and MTF from the signal at distances (pixels) across an edge."""
    reach = 96
    place = np.floor((across + reach) * _FINER).astype(int)
    inside = (place >= 0) & (place < 2 * reach * _FINER)
    count = np.bincount(place[inside], minlength=2 * reach * _FINER)
    spread = np.bincount(place[inside], pixels[inside], 2 * reach * _FINER) / np.maximum(count, 1)
    line = np.diff(spread)
    transform = np.abs(np.fft.rfft(line))
    frequency = np.fft.rfftfreq(len(line), pixel_mm / _FINER)
    # Differences and bins are two apertures of their own.
    transform /= np.sinc(frequency * pixel_mm / _FINER) ** 2
    wanted = frequency < 0.5 / pixel_mm
    return np.asarray(frequency[wanted], np.float64), np.asarray(transform[wanted] / transform[0], np.float64)


def flat_fields(technique: Technique, count: int = _FIELDS) -> Array:
    """(count, rows, cols)  exposures of the open beam, linear pixels less their offset"""
    side = _ROI_PX * _ROIS
    flat = bare(technique, side)
    images = [_pixels(_exposed({}, flat, seed=number)) for number in range(count)]
    return np.array(images, np.float64) - technique.detector.offset_dn


def nnps(technique: Technique) -> Curve:
    """Normalised noise power spectrum of flat fields, mm2, averaged over directions (IEC 62220-1)."""
    fields, pixel_mm = flat_fields(technique), technique.protocol.pixel_mm
    # Their mean is taken off: the inverse square fall of the beam is no noise, but one part in `count` of the noise is.
    residual = (fields - fields.mean(axis=0)) * np.sqrt(len(fields) / (len(fields) - 1))
    regions = residual.reshape(len(fields), _ROIS, _ROI_PX, _ROIS, _ROI_PX).swapaxes(2, 3)
    # A Hann window: without one, power of low frequencies leaks to high ones, where there is thirty times less.
    window = np.outer(np.hanning(_ROI_PX), np.hanning(_ROI_PX))
    power = (np.abs(np.fft.fft2(regions * window)) ** 2).mean(axis=(0, 1, 2)) * pixel_mm**2 / (window**2).sum()
    f = np.fft.fftfreq(_ROI_PX, pixel_mm)
    radius = np.hypot(*np.meshgrid(f, f))
    frequency, measured = _radial(radius, power / fields.mean() ** 2, pixel_mm)
    meant = model_nnps(technique, radius, float(fields.mean()))
    return Curve(frequency, measured, _radial(radius, meant, pixel_mm)[1])


def model_nnps(technique: Technique, per_mm: Array, mean_dn: float) -> Array:
    """(...)  quanta seen through their own transfer, readout noise and rounding, mm2

    per_mm  (...)  cycles/mm
    """
    protocol, detector, beam = technique.protocol, technique.detector, beam_of(technique)
    per_dn = detector.electrons_per_dn_mm2 * protocol.pixel_mm**2
    weights = beam.photons_per_mm2 * beam.signal_kev
    quantum_kev = (beam.photons_per_mm2 * beam.square_kev2).sum() / weights.sum() / detector.swank
    quanta = mean_dn * per_dn / detector.electrons_per_kev / quantum_kev
    readout = (detector.readout_electrons / per_dn) ** 2 + 1 / 12
    blurred = protocol.detector_blur != "none"
    passed = transfer(detector, per_mm, "ntf") ** 2 if blurred else np.ones_like(per_mm)
    noise = passed / quanta + readout / mean_dn**2
    return np.asarray(noise * protocol.pixel_mm**2)


def dqe(technique: Technique) -> Curve:
    """Detective quantum efficiency, MTF^2 / (NNPS q), of the open beam of a protocol"""
    noise, sharp = nnps(technique), mtf(technique)
    q = beam_of(technique).photons_per_mm2.sum() * (1000.0 / technique.protocol.sdd_mm) ** 2
    at = np.interp(noise.per_mm, sharp.per_mm, sharp.measured)
    meant = model_mtf(technique, noise.per_mm) ** 2
    return Curve(noise.per_mm, at**2 / (noise.measured * q), meant / (noise.model * q))


def photon_transfer(technique: Technique, steps: int = 6) -> list[tuple[float, float, float]]:
    """Mean, variance and the variance meant (DN, DN^2) of flat fields without detector blur, by rising mAs."""
    rows = []
    for mas in technique.protocol.mas * np.geomspace(1 / 64, 1.0, steps):
        sharp = technique.taken(mas=float(mas), detector_blur="none")
        one, other = flat_fields(sharp, 2)
        mean = float((one.mean() + other.mean()) / 2)
        meant = float(model_nnps(sharp, np.zeros(1), mean)[0]) / technique.protocol.pixel_mm**2 * mean**2
        rows.append((mean, float((one - other).var() / 2), meant))
    return rows


def noise_moments(technique: Technique) -> dict[str, tuple[float, float, float]]:
    """How normal the noise of a flat field is, without detector blur, in units of the deviation meant.

    returns  moment -> value, and from where to where it may be by chance: four standard errors of its sample count
    """
    flat = bare(technique, _ROI_PX * _ROIS).taken(detector_blur="none")
    image, offset = _exposed({}, flat, seed=9, keep=frozenset({"noise_free"})), flat.detector.offset_dn
    pixels, mean = _pixels(image), image.kept["noise_free"].astype(np.float64) - offset
    variance = model_nnps(flat, np.zeros(1), mean) / flat.protocol.pixel_mm**2 * mean**2
    off, n = (pixels - offset - mean) / np.sqrt(variance), pixels.size
    # That of Poisson counts, or none where they are drawn as normal.
    quanta = float(np.mean(mean**2 / variance))
    skewness = 1 / np.sqrt(quanta) if quanta < GAUSSIAN_FROM else 0.0
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


def _exposed(
    path_mm: Mapping[str, NDArray[np.float32]], technique: Technique, seed: int = 0, keep: frozenset[str] = frozenset()
) -> LatentImage:
    """What lies behind path lengths (rows, cols), mm, in a beam without scatter."""
    image = LatentImage(path_mm=path_mm)
    expose(image, Chain(technique=technique, seed=seed, keep=keep))
    return image


def _pixels(image: LatentImage) -> NDArray[np.uint16]:
    assert image.pixels is not None
    return image.pixels


def _radial(radius: Array, power: Array, pixel_mm: float) -> tuple[Array, Array]:
    """Means over rings of frequency, the axes and the zero left out, up to the Nyquist frequency."""
    step = radius[0, 1] * 2
    used = (np.arange(len(radius))[:, None] > 0) & (np.arange(len(radius)) > 0) & (radius < 0.5 / pixel_mm)
    ring = np.rint(radius[used] / step).astype(int)
    count = np.bincount(ring)
    kept = count > 0
    return (np.bincount(ring, radius[used]) / np.maximum(count, 1))[kept], (
        np.bincount(ring, power[used]) / np.maximum(count, 1)
    )[kept]
