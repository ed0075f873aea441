"""Estimate the noise of a detector from homogeneous regions of radiographs of patients."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..scatter.antiscatter_grid import make_grid, transmit_through_grid
from ..xray.materials import attenuation_per_mm
from ..xray.resolved_technique import Technique
from ..xray.spectrum import compute_beam
from .frequency_rings import Rings, make_rings, split_regions, transform_regions
from .noise_spectrum import FlatSpectra, NoiseFit, add_noise_power, compute_ntf, fit_noise
from .signal_response import is_saturated

# Side length of a region, in pixels, and degree of the trend that is subtracted from it.
_REGION_PX, _TREND_DEGREE = 64, 3
# Rings of low frequencies by which regions with structure are recognised, and first ring of the fit. The rings of the
# fit are others, so that the selection does not change their noise.
_STRUCTURE_RINGS, _FIRST_RING = slice(2, 5), 6
# Power of the structure rings relative to noise up to which a region is homogeneous.
_HOMOGENEOUS = 1.25
# Smallest number of homogeneous regions, and number of regions per signal level and of levels.
_LEAST_REGIONS, _PER_LEVEL, _LEVELS = 40, 20, 12
# Fraction of the regions with the least structure from which the selection starts.
_START = 0.05
# Largest number of iterations of the selection.
_ITERATIONS = 20
# Quantile of the regions that is taken for the open beam, relative range of its signal, and smallest fraction of the
# regions in this range.
_OPEN_QUANTILE, _OPEN_RANGE, _OPEN_SHARE = 0.995, 0.1, 0.02
# Muscle in the beam, in mm, for which the noise per signal is tabulated.
_MUSCLE_MM = np.linspace(0.0, 300.0, 61)


class RadiographNoise(NamedTuple):
    """Noise of radiographs.

    Attributes
    ----------
    spectra : FlatSpectra
        Noise power spectra of homogeneous regions by signal level.
    fit : NoiseFit
        Noise per signal of the open beam, NTF and readout noise.
    open_dn : float or None
        Signal of the open beam, in DN; None if no radiograph shows it below saturation.
    saturation_dn : int or None
        Largest pixel value, in DN; None if no radiograph is saturated.
    regions : int
        Number of homogeneous regions.
    """

    spectra: FlatSpectra
    fit: NoiseFit
    open_dn: float | None
    saturation_dn: int | None
    regions: int


class _Regions(NamedTuple):
    """Mean signal (regions,) in DN and power (regions, rings) in DN2 per pixel of the regions of radiographs."""

    mean_dn: Array
    power_dn2: Array


def measure_radiograph_noise(
    radiographs: Sequence[NDArray[np.uint16]],
    technique: Technique,
    readout_dn: tuple[float, float] | None,
    start: tuple[float, float],
) -> RadiographNoise:
    """Estimate noise per signal and NTF from homogeneous regions of radiographs.

    Parameters
    ----------
    radiographs : sequence of (rows, cols) uint16 array, DN
        Linear radiographs of patients.
    technique : Technique
        Beam, pixel pitch and detector with its offset.
    readout_dn : (float, float), optional
        Readout noise and its relative standard error from dark images, in DN and dimensionless. None if there are no
        dark images.
    start : (float, float)
        Starting values of f0, in 1/mm, and of the exponent of the NTF.

    Returns
    -------
    RadiographNoise
        Spectra and fit.

    Raises
    ------
    InputError
        If the radiographs have too few homogeneous regions.

    Notes
    -----
    Anatomy adds power at low frequencies. A region is homogeneous if its power at 0.03 to 0.06 cycles per pixel is that
    of noise; higher frequencies are fitted. A patient hardens the beam, so that the noise per signal increases with
    attenuation; this increase is that of muscle.
    """
    offset, pixel_mm = technique.detector.offset_dn, technique.protocol.pixel_mm
    saturation = _find_saturation(radiographs)
    rings = make_rings(_REGION_PX, pixel_mm)
    regions = _measure_regions(radiographs, offset, saturation, rings)
    if len(regions.mean_dn) < _LEAST_REGIONS:
        raise InputError(
            f"radiographs must have at least {_LEAST_REGIONS} regions of {_REGION_PX} x {_REGION_PX} pixels below "
            f"saturation, got {len(regions.mean_dn)}"
        )
    open_dn = _find_open_beam(regions.mean_dn, saturation)
    brightest = open_dn or float((saturation or regions.mean_dn.max() + offset) - offset)
    hardening = _compute_hardening(regions.mean_dn, brightest, technique)
    spectra, fit, count = _select_and_fit(regions, hardening, rings, readout_dn, start)
    return RadiographNoise(spectra, fit, open_dn, saturation, count)


def _find_saturation(radiographs: Sequence[NDArray[np.uint16]]) -> int | None:
    """Find the largest pixel value in DN if it occurs in more than 1 % of the pixels of a radiograph."""
    return min((int(image.max()) for image in radiographs if is_saturated(image)), default=None)


def _measure_regions(
    radiographs: Sequence[NDArray[np.uint16]], offset_dn: float, saturation_dn: int | None, rings: Rings
) -> _Regions:
    """Measure signal and power of all regions below saturation and above the offset."""
    means, powers = [], []
    for image in radiographs:
        regions = split_regions(image.astype(np.float64), _REGION_PX)
        most = regions.max(axis=(1, 2)) < (np.inf if saturation_dn is None else saturation_dn)
        regions = regions[most & (regions.min(axis=(1, 2)) > offset_dn)] - offset_dn
        if len(regions):
            power = np.abs(transform_regions(regions, _TREND_DEGREE)) ** 2
            means.append(regions.mean(axis=(1, 2)))
            powers.append(np.array([rings.average(each) for each in power]))
    if not means:
        return _Regions(np.empty(0), np.empty((0, len(rings.members))))
    return _Regions(np.concatenate(means), np.concatenate(powers))


def _find_open_beam(mean_dn: Array, saturation_dn: int | None) -> float | None:
    """Find the signal of the open beam in DN: that of the brightest regions, if many have nearly the same signal."""
    if saturation_dn is not None:
        return None
    brightest = float(np.quantile(mean_dn, _OPEN_QUANTILE))
    share = float((np.abs(mean_dn / brightest - 1) < _OPEN_RANGE).mean())
    return brightest if share >= _OPEN_SHARE else None


def _compute_hardening(mean_dn: Array, open_dn: float, technique: Technique) -> Array:
    """Compute the noise per signal of regions (regions,) behind muscle, relative to the open beam."""
    beam = compute_beam(technique)
    if technique.protocol.grid_ratio > 0:
        beam = transmit_through_grid(make_grid(technique.protocol), beam)
    mu = attenuation_per_mm(technique.material("muscle"), beam.energies_kev)
    photons = beam.photons_per_mm2 * np.exp(-np.outer(_MUSCLE_MM, mu))
    signal = photons @ beam.signal_kev
    per_signal = photons @ beam.square_kev2 / signal
    attenuation = np.log(open_dn / np.minimum(mean_dn, open_dn))
    return np.asarray(np.interp(attenuation, np.log(signal[0] / signal), per_signal / per_signal[0]))


def _select_and_fit(
    regions: _Regions,
    hardening: Array,
    rings: Rings,
    readout_dn: tuple[float, float] | None,
    start: tuple[float, float],
) -> tuple[FlatSpectra, NoiseFit, int]:
    """Select homogeneous regions and fit their noise, in turns until the selection no longer changes."""
    low = rings.frequency_per_mm[_STRUCTURE_RINGS]
    structure = np.average(regions.power_dn2[:, _STRUCTURE_RINGS], axis=1, weights=rings.members[_STRUCTURE_RINGS])
    quanta = regions.mean_dn * hardening
    kept = structure / quanta <= np.quantile(structure / quanta, max(_START, _LEAST_REGIONS / len(quanta)))
    for _ in range(_ITERATIONS):
        spectra = _average_levels(regions, hardening, kept, rings)
        fit = fit_noise(spectra, readout_dn, start)
        ntf = compute_ntf(low, fit.ntf_f0_per_mm, fit.ntf_power)
        transfer = float(np.average(ntf**2, weights=rings.members[_STRUCTURE_RINGS]))
        expected = add_noise_power(fit.noise_per_signal_dn * quanta * transfer, fit.readout_dn)
        homogeneous = structure <= _HOMOGENEOUS * expected
        if homogeneous.sum() < _LEAST_REGIONS:
            raise InputError(
                f"radiographs must have at least {_LEAST_REGIONS} homogeneous regions of {_REGION_PX} x {_REGION_PX} "
                f"pixels, got {homogeneous.sum()} of {len(quanta)}"
            )
        if (homogeneous == kept).all():
            break
        kept = homogeneous
    return spectra, fit, int(kept.sum())


def _average_levels(regions: _Regions, hardening: Array, kept: NDArray[np.bool_], rings: Rings) -> FlatSpectra:
    """Average the spectra of regions over levels with equal numbers of regions."""
    order = np.flatnonzero(kept)[np.argsort(regions.mean_dn[kept], kind="stable")]
    levels = np.array_split(order, int(np.clip(len(order) // _PER_LEVEL, 2, _LEVELS)))
    return FlatSpectra(
        frequency_per_mm=rings.frequency_per_mm[_FIRST_RING:],
        power_dn2=np.array([regions.power_dn2[level].mean(axis=0) for level in levels])[:, _FIRST_RING:],
        relative_error=np.array([rings.relative_error(len(level)) for level in levels])[:, _FIRST_RING:],
        mean_dn=np.array([regions.mean_dn[level].mean() for level in levels]),
        hardening=np.array([hardening[level].mean() for level in levels]),
        pattern=0.0,
        pattern_error=np.inf,
    )
