"""Estimate the quantum noise of a detector from flat fields: noise per signal, NTF and gain variation."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..core.checks import Array
from ..detector.detector_blur import compute_transfer
from ..model.detector import Detector
from .dark_noise import ROUNDING_VARIANCE
from .estimate import compute_covariance
from .frequency_rings import WINDOW_CORRELATION, make_rings, split_regions, transform_regions

# Side length of a region for the noise power spectrum, in pixels.
_ROI_PX = 128
# Degree of the trend that is subtracted from each region.
_TREND_DEGREE = 2
# Rings of the lowest frequencies, which the subtraction of the trend changes, are left out.
_FIRST_RING = 4
# Lowest frequency of the fixed pattern, relative to the Nyquist frequency.
_PATTERN_FROM = 0.2
# Range of the logarithms of noise per signal, f0, exponent and readout noise around their starting values.
_FIT_RANGE = np.array([3.0, 5.0, 3.0, 9.0])
# Number of standard errors above which a fixed pattern is detected.
_DETECTED = 3.0
# Sensitivity of the spectra to the readout noise, relative to that to the noise per signal, below which the readout
# noise is not determined.
_INSENSITIVE = 1e-4


class FlatSpectra(NamedTuple):
    """Noise power spectra of flat fields, or of homogeneous regions of radiographs, averaged over rings.

    Attributes
    ----------
    frequency_per_mm : (rings,) float64 array
        Spatial frequencies, in cycles per mm.
    power_dn2 : (flats, rings) float64 array
        Noise power divided by the pixel area, in DN2 per pixel: the variance of a pixel if the noise were white.
    relative_error : (rings,) or (flats, rings) float64 array
        Relative standard error of the power.
    mean_dn : (flats,) float64 array
        Mean signal, in DN.
    hardening : (flats,) float64 array
        Noise per signal relative to the open beam, dimensionless; above 1 behind a patient, who hardens the beam.
    pattern : float
        Squared relative standard deviation of the fixed pattern of the pixels, dimensionless.
    pattern_error : float
        Standard error of `pattern`.
    """

    frequency_per_mm: Array
    power_dn2: Array
    relative_error: Array
    mean_dn: Array
    hardening: Array
    pattern: float
    pattern_error: float


def measure_flat_spectra(flats: Sequence[Array], pixel_mm: float) -> FlatSpectra:
    """Measure the noise power spectrum of each flat field.

    Parameters
    ----------
    flats : sequence of (rows, cols) float64 array, DN
        Linear flat fields without offset, of at least 128 x 128 pixels.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    FlatSpectra
        Spectra. In each region, a quadratic trend is subtracted.
    """
    rings = make_rings(_ROI_PX, pixel_mm)
    transforms, means = [], []
    for flat in flats:
        regions = split_regions(flat, _ROI_PX)
        means.append(float(regions.mean()))
        transforms.append(transform_regions(regions, _TREND_DEGREE))
    used = rings.used & (rings.number >= _FIRST_RING)
    power = np.array([rings.average((np.abs(each) ** 2).mean(axis=0)) for each in transforms])[:, _FIRST_RING:]
    error = rings.relative_error(len(transforms[0]))[_FIRST_RING:]
    high = used & (rings.radius_per_mm > _PATTERN_FROM * 0.5 / pixel_mm)
    pattern = _measure_pattern(transforms, means, high)
    return FlatSpectra(
        rings.frequency_per_mm[_FIRST_RING:], power, error, np.array(means), np.ones(len(means)), *pattern
    )


def _measure_pattern(
    transforms: Sequence[Array], means: Sequence[float], high: NDArray[np.bool_]
) -> tuple[float, float]:
    """Measure the squared relative pattern that all flat fields have in common, and its standard error."""
    products, errors = [], []
    for one in range(len(transforms)):
        for other in range(one):
            scale = means[one] * means[other]
            cross = (transforms[one] * transforms[other].conj()).real.mean(axis=0)[high] / scale
            noise = np.sqrt((np.abs(transforms[one]) ** 2).mean() * (np.abs(transforms[other]) ** 2).mean()) / scale
            products.append(cross.mean())
            errors.append(noise * np.sqrt(WINDOW_CORRELATION / (high.sum() * len(transforms[one]))))
    if not products:
        return 0.0, np.inf
    weights = np.array(errors) ** -2
    return float(np.average(products, weights=weights)), float(weights.sum() ** -0.5)


def predict_power(detector: Detector, spectra: FlatSpectra, pixel_mm: float, noise_per_signal_dn: float) -> Array:
    """Predict the noise power of flat fields from the properties of a detector.

    Parameters
    ----------
    detector : Detector
        Detector with NTF, readout noise and gain variation.
    spectra : FlatSpectra
        Frequencies and mean signals.
    pixel_mm : float
        Pixel pitch, in mm.
    noise_per_signal_dn : float
        Variance of a pixel divided by its signal at frequency 0, in DN.

    Returns
    -------
    (flats, rings) float64 array
        Noise power divided by the pixel area, in DN2 per pixel.
    """
    signal = spectra.mean_dn[:, None]
    ntf = compute_transfer(detector, spectra.frequency_per_mm, "ntf")
    readout_dn = detector.readout_electrons / (detector.electrons_per_dn_mm2 * pixel_mm**2)
    pattern = (detector.gain_variation * signal) ** 2
    return add_noise_power(noise_per_signal_dn * signal * spectra.hardening[:, None] * ntf**2, readout_dn) + pattern


def compute_ntf(frequency_per_mm: Array, f0_per_mm: float, power: float) -> Array:
    """Compute the NTF by its equation 1 / (1 + (f / f0)^power).

    Parameters
    ----------
    frequency_per_mm : (n,) array, 1/mm
        Spatial frequencies f, in cycles per mm.
    f0_per_mm : float
        Spatial frequency f0, in 1/mm.
    power : float
        Exponent.

    Returns
    -------
    (n,) float64 array
        NTF, from 0 to 1.
    """
    return np.asarray(1 / (1 + (frequency_per_mm / f0_per_mm) ** power))


def add_noise_power(quantum_dn2: Array, readout_dn: float) -> Array:
    """Add the power of readout noise and of rounding to that of quantum noise.

    Parameters
    ----------
    quantum_dn2 : (...) array
        Power of the quantum noise divided by the pixel area, in squared DN.
    readout_dn : float
        Readout noise, in DN.

    Returns
    -------
    (...) float64 array
        Noise power divided by the pixel area, in DN2.
    """
    return np.asarray(quantum_dn2 + readout_dn**2 + ROUNDING_VARIANCE)


class NoiseFit(NamedTuple):
    """Parameters of the quantum noise.

    Attributes
    ----------
    noise_per_signal_dn : float
        Variance of a pixel divided by its signal at frequency 0, in DN.
    ntf_f0_per_mm : float
        Spatial frequency f0 of the NTF, in 1/mm.
    ntf_power : float
        Exponent of the NTF.
    readout_dn : float
        Standard deviation of the readout noise, in DN.
    gain_variation : float
        Relative standard deviation of the gains of the pixels.
    covariance : (4, 4) float64 array
        Covariance of the logarithms of the first four values.
    reduced_chi2 : float
        Mean squared residual divided by its expected value.
    """

    noise_per_signal_dn: float
    ntf_f0_per_mm: float
    ntf_power: float
    readout_dn: float
    gain_variation: float
    covariance: Array
    reduced_chi2: float


def fit_noise(spectra: FlatSpectra, readout_dn: tuple[float, float] | None, start: tuple[float, float]) -> NoiseFit:
    """Fit the quantum noise, the NTF and the readout noise to the spectra of flat fields.

    Parameters
    ----------
    spectra : FlatSpectra
        Spectra of flat fields at one or more exposures.
    readout_dn : (float, float), optional
        Readout noise and its relative standard error from dark images, in DN and dimensionless. None if there are no
        dark images.
    start : (float, float)
        Starting values of f0, in 1/mm, and of the exponent of the NTF.

    Returns
    -------
    NoiseFit
        Values of maximum likelihood: the power of a ring has a gamma distribution.
    """
    pattern = spectra.pattern if spectra.pattern > _DETECTED * spectra.pattern_error else 0.0
    signal = spectra.mean_dn[:, None]
    quanta = signal * spectra.hardening[:, None]
    first = (spectra.power_dn2[:, :8].mean(axis=1) / spectra.mean_dn).mean()
    weakest = float(spectra.power_dn2.min())
    guess = readout_dn[0] if readout_dn else float(np.sqrt(0.2 * weakest))

    def residuals(logs: Array) -> Array:
        per_signal, f0, power, readout = np.exp(logs)
        ntf = compute_ntf(spectra.frequency_per_mm, f0, power)
        model = add_noise_power(per_signal * quanta * ntf**2, readout) + pattern * signal**2
        ratio = spectra.power_dn2 / model
        deviance = np.sign(ratio - 1) * np.sqrt(np.maximum(2 * (ratio - 1 - np.log(ratio)), 0))
        terms = (deviance / spectra.relative_error).ravel()
        if readout_dn is None:
            return np.asarray(terms)
        return np.append(terms, (logs[3] - np.log(readout_dn[0])) / readout_dn[1])

    begin = np.log([first, *start, max(guess, 1e-3)])
    optimum = least_squares(residuals, begin, bounds=(begin - _FIT_RANGE, begin + _FIT_RANGE), x_scale="jac")
    free = max(1, spectra.power_dn2.size - 4)
    chi2 = float((optimum.fun[: spectra.power_dn2.size] ** 2).sum()) / free
    per_signal, f0, power, readout = (float(value) for value in np.exp(optimum.x))
    return NoiseFit(
        per_signal, f0, power, readout, float(np.sqrt(pattern)), _compute_noise_covariance(optimum.jac), chi2
    )


def _compute_noise_covariance(jacobian: Array) -> Array:
    """Compute the covariance (4, 4); the variance of a readout noise that the spectra do not show is infinite."""
    sensitivity = np.linalg.norm(jacobian, axis=0)
    if sensitivity[3] > _INSENSITIVE * sensitivity[0]:
        return compute_covariance(jacobian)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = compute_covariance(jacobian[:, :3])
    covariance[3, 3] = np.inf
    return covariance
