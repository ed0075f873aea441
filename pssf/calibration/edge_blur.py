"""Estimate the presampled MTF of a detector from the image of a slanted edge."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ..core.checks import Array, InputError
from ..quality.image_quality import compute_edge_mtf, find_edge_distance
from .estimate import compute_covariance

# Number of strips along the edge, from whose scatter the error follows.
_STRIPS = 8
# Smallest length of a strip, in pixels.
_LEAST_STRIP_PX = 32
# Lowest and highest frequency of the fit, relative to the Nyquist frequency. The tails of the edge that are outside the
# image change the MTF at lower frequencies, and its value at frequency 0, to which it is normalised.
_FITTED_FROM = 0.02
_FITTED_TO = 0.95
# Range of the logarithms of f0, exponent and scale around their starting values.
_FIT_RANGE = np.array([5.0, 3.0, 0.1])
# Number of bands of frequencies in which the error is computed; within a band, the error is constant.
_BANDS = 12


class EdgeMtf(NamedTuple):
    """Presampled MTF of the image of an edge.

    Attributes
    ----------
    frequency_per_mm : (n,) float64 array
        Spatial frequencies up to the Nyquist frequency, in cycles per mm.
    mtf : (n,) float64 array
        MTF, 1 at frequency 0.
    standard_error : (n,) float64 array
        Standard error of the MTF at one frequency, dimensionless.
    """

    frequency_per_mm: Array
    mtf: Array
    standard_error: Array


class MtfFit(NamedTuple):
    """Parameters of the MTF 1 / (1 + (f / f0)^power).

    Attributes
    ----------
    f0_per_mm : float
        Spatial frequency f0, in 1/mm.
    power : float
        Exponent.
    covariance : (2, 2) float64 array
        Covariance of the logarithms of both values.
    deviation : float
        Largest difference between the measured MTF, averaged over bands, and the equation, dimensionless.
    deviation_errors : float
        The same difference in standard errors.
    """

    f0_per_mm: float
    power: float
    covariance: Array
    deviation: float
    deviation_errors: float


def measure_edge(image: Array, pixel_mm: float) -> EdgeMtf:
    """Measure the presampled MTF and its error.

    Parameters
    ----------
    image : (rows, cols) float64 array, DN
        Linear image of a slanted edge.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    EdgeMtf
        MTF of the whole image. The error is that of the mean of 8 strips along the edge.

    Raises
    ------
    InputError
        If the image shows no straight edge, or the edge is shorter than 256 pixels.
    """
    distance = find_edge_distance(image)
    along = 0 if np.abs(np.diff(distance, axis=0)).mean() < np.abs(np.diff(distance, axis=1)).mean() else 1
    if image.shape[along] < _STRIPS * _LEAST_STRIP_PX:
        raise InputError(f"edge must be at least {_STRIPS * _LEAST_STRIP_PX} pixels long, got {image.shape[along]}")
    frequency, mtf = compute_edge_mtf(image, distance, pixel_mm)
    parts = []
    for rows, away in zip(
        np.array_split(image, _STRIPS, axis=along), np.array_split(distance, _STRIPS, axis=along), strict=True
    ):
        at, values = compute_edge_mtf(rows, away, pixel_mm)
        parts.append(np.interp(frequency, at, values))
    error = np.std(parts, axis=0, ddof=1) / np.sqrt(_STRIPS)
    return EdgeMtf(frequency, mtf, _smooth_error(frequency, error))


def _smooth_error(frequency: Array, error: Array) -> Array:
    """Replace the error at each frequency by its root mean square within a band."""
    band = np.minimum((frequency / frequency[-1] * _BANDS).astype(int), _BANDS - 1)
    mean = np.sqrt(np.bincount(band, error**2) / np.bincount(band))
    centres = (np.arange(_BANDS) + 0.5) / _BANDS * frequency[-1]
    return np.asarray(np.maximum(np.interp(frequency, centres, mean), 1e-6))


def fit_mtf(edge: EdgeMtf, start: tuple[float, float]) -> MtfFit:
    """Fit the equation of the MTF to a measured MTF.

    Parameters
    ----------
    edge : EdgeMtf
        Measured MTF.
    start : (float, float)
        Starting values of f0, in 1/mm, and of the exponent.

    Returns
    -------
    MtfFit
        Fitted values. The errors at neighbouring frequencies are independent.
    """
    nyquist = edge.frequency_per_mm[-1]
    used = (edge.frequency_per_mm > _FITTED_FROM * nyquist) & (edge.frequency_per_mm <= _FITTED_TO * nyquist)
    frequency, mtf, error = (values[used] for values in edge)

    def residuals(logs: Array) -> Array:
        f0, power, scale = np.exp(logs)
        return np.asarray((mtf - scale / (1 + (frequency / f0) ** power)) / error)

    begin = np.append(np.log(start), 0.0)
    optimum = least_squares(residuals, begin, bounds=(begin - _FIT_RANGE, begin + _FIT_RANGE), x_scale="jac")
    band = np.minimum((frequency / frequency[-1] * _BANDS).astype(int), _BANDS - 1)
    count = np.bincount(band)
    difference = np.bincount(band, optimum.fun * error) / count
    in_errors = difference / (np.bincount(band, error) / count / np.sqrt(count))
    worst = int(np.abs(difference).argmax())
    f0, power, _ = (float(value) for value in np.exp(optimum.x))
    return MtfFit(
        f0, power, compute_covariance(optimum.jac)[:2, :2], float(abs(difference[worst])), float(abs(in_errors[worst]))
    )


def make_mtf_table(edge: EdgeMtf, count: int = 40) -> tuple[tuple[float, float], ...]:
    """Make a table of a measured MTF, averaged over bands of frequencies.

    Parameters
    ----------
    edge : EdgeMtf
        Measured MTF.
    count : int, default 40
        Number of bands up to the Nyquist frequency.

    Returns
    -------
    tuple of (float, float)
        Spatial frequency in 1/mm and MTF, beginning with frequency 0 and value 1.
    """
    band = np.minimum((edge.frequency_per_mm / edge.frequency_per_mm[-1] * count).astype(int), count - 1)
    band[0] = -1
    kept = [np.flatnonzero(band == number) for number in range(count)]
    rows = [
        (round(float(edge.frequency_per_mm[at].mean()), 6), round(float(np.clip(edge.mtf[at].mean(), 0, 2)), 6))
        for at in kept
        if len(at)
    ]
    return ((0.0, 1.0), *rows)
