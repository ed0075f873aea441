"""Estimate the offset and the readout noise of a detector from images without exposure."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtr

from ..core.checks import Array
from .estimate import Estimate, make_estimate

# Largest distance of a sound pixel from the median, in standard deviations; these are estimated by percentiles.
_DEFECT_DEVIATIONS = 8.0
# Variance of rounding to whole numbers, in DN2.
ROUNDING_VARIANCE = 1.0 / 12.0
# Standard deviation below which rounding to whole numbers hides the noise, in DN.
_ROUNDED_DN = 0.3
# Ratio of the spatial to the temporal variance above which the pixels have different offsets.
_PATTERN_RATIO = 1.05
# Step of the numerical derivative of the log-likelihood, relative to the standard deviation.
_STEP = 1e-3


class DarkNoise(NamedTuple):
    """Offset and readout noise of a panel.

    Attributes
    ----------
    offset_dn : Estimate
        Mean value of a pixel without exposure, in DN.
    noise_dn : Estimate
        Standard deviation of the readout noise before rounding, in DN.
    """

    offset_dn: Estimate
    noise_dn: Estimate


def estimate_dark_noise(darks: Sequence[NDArray[np.uint16]]) -> DarkNoise:
    """Estimate the offset and the readout noise from dark images.

    Parameters
    ----------
    darks : sequence of (rows, cols) uint16 array, DN
        Images without exposure. From two images on, the noise is that between images if the pixels have different
        offsets.

    Returns
    -------
    DarkNoise
        Offset and readout noise with their intervals. The values of a pixel are those of a normal distribution, rounded
        to whole numbers and not below 0; the estimate is that of maximum likelihood.
    """
    values = _remove_defects(np.concatenate([dark.ravel() for dark in darks]).astype(np.int64))
    mean, sd, covariance = _fit_rounded_normal(values)
    if len(darks) > 1:
        difference = np.concatenate([(one.astype(float) - other).ravel() for one, other in pairwise(darks)])
        kept = np.abs(difference) < _DEFECT_DEVIATIONS * np.sqrt(2) * max(sd, 0.5)
        temporal = max(float(difference[kept].var()) / 2 - ROUNDING_VARIANCE, 0.0)
        if sd**2 > _PATTERN_RATIO * temporal and temporal > 0:
            error = np.sqrt(temporal / kept.sum()) * (1 + ROUNDING_VARIANCE / temporal)
            note = "noise between images; pixels have different offsets"
            return DarkNoise(
                make_estimate(mean, float(np.sqrt(covariance[0, 0]))),
                make_estimate(float(np.sqrt(temporal)), float(error), note=note),
            )
    return DarkNoise(
        make_estimate(mean, float(np.sqrt(covariance[0, 0])), is_positive=False),
        make_estimate(sd, float(np.sqrt(covariance[1, 1]))),
    )


def _remove_defects(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Remove the values of defective pixels, which are far from the median."""
    low, median, high = np.percentile(values, [16, 50, 84])
    allowed = _DEFECT_DEVIATIONS * max((high - low) / 2, 0.5)
    return values[np.abs(values - median) <= allowed]


def _fit_rounded_normal(values: NDArray[np.int64]) -> tuple[float, float, Array]:
    """Fit mean and standard deviation of a normal distribution to values that are rounded and not below 0."""
    levels, counts = np.unique(values, return_counts=True)

    def cost(parameters: Array) -> float:
        mean, sd = parameters[0], np.exp(parameters[1])
        upper = ndtr((levels + 0.5 - mean) / sd)
        lower = np.where(levels > 0, ndtr((levels - 0.5 - mean) / sd), 0.0)
        return -float(counts @ np.log(np.maximum(upper - lower, 1e-300)))

    start = np.array([values.mean(), np.log(max(np.sqrt(max(values.var() - ROUNDING_VARIANCE, 0)), 0.1))])
    best = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-6, "maxiter": 4000}).x
    sd = float(np.exp(best[1]))
    steps = np.array([_STEP * sd, _STEP]) * 10
    hessian = np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            corners = [
                cost(best + np.eye(2)[i] * steps[i] * a + np.eye(2)[j] * steps[j] * b) for a in (1, -1) for b in (1, -1)
            ]
            hessian[i, j] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * steps[i] * steps[j])
    covariance = np.linalg.pinv(hessian)
    covariance[:, 1] *= sd
    covariance[1] *= sd
    if sd < _ROUNDED_DN or covariance[0, 0] <= 0 or covariance[1, 1] <= 0:
        # Values that are nearly all equal after rounding determine the mean and the noise only to a fraction of 1 DN.
        covariance = np.diag([ROUNDING_VARIANCE, sd**2])
    return float(best[0]), sd, np.asarray(covariance, np.float64)
