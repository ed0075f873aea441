"""Slopes of log-log curves: over all scales, and by scale."""

import numpy as np

from ..core.checks import Array


def fit_slope(scales: Array, values: Array) -> Array:
    """Fit power laws to values by scale, by least squares of logarithms.

    Parameters
    ----------
    scales : (n,) array
        Scales, in any unit.
    values : (..., n) array, any unit
        Positive values at each scale.

    Returns
    -------
    (...,) array
        Exponent of each power law.
    """
    x = np.log(scales) - np.log(scales).mean()
    return np.asarray(np.log(values) @ x / (x @ x))


def fit_local_slopes(scales: Array, values: Array) -> Array:
    """Fit power laws to each three neighbouring scales.

    Parameters
    ----------
    scales : (n,) array
        Scales, in any unit, at least three.
    values : (..., n) array, any unit
        Positive values at each scale.

    Returns
    -------
    (..., n - 2) array
        Exponent at each scale except the first and the last.
    """
    return np.stack(
        [fit_slope(scales[at : at + 3], values[..., at : at + 3]) for at in range(len(scales) - 2)], axis=-1
    )


def fit_parabola(scales_mm: Array, dimensions: Array) -> tuple[float, float, float]:
    """Fit a parabola to a fractal signature (Kraus 2009).

    Parameters
    ----------
    scales_mm : (n,) array
        Scales, in mm.
    dimensions : (n,) array, dimensionless
        Fractal dimension at each scale.

    Returns
    -------
    level, slope_per_mm, curvature_per_mm2 : float
        Coefficients of the powers 0, 1 and 2 of the scale minus the mean scale. With fewer than three scales, the
        curvature is 0.
    """
    degree = min(2, len(scales_mm) - 1)
    coefficients = np.zeros(3)
    coefficients[: degree + 1] = np.polynomial.polynomial.polyfit(scales_mm - scales_mm.mean(), dimensions, degree)
    level, slope, curvature = coefficients.tolist()
    return level, slope, curvature
