"""Ellipse of a rose plot."""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array

# Smallest radius of a rose plot; Hurst coefficients of noise may be below 0.
_MIN_RADIUS = 0.01


@dataclass(frozen=True, kw_only=True)
class RoseEllipse:
    """Ellipse around the origin that is fitted to a rose plot.

    Attributes
    ----------
    aspect_ratio : float
        Minor axis divided by major axis, 0 to 1; 1 for an isotropic texture.
    orientation_deg : float
        Direction of the major axis, in degrees counter-clockwise from the rows of the image, 0 to 180.
    """

    aspect_ratio: float
    orientation_deg: float


def fit_ellipse(directions_deg: Array, radii: Array) -> RoseEllipse:
    """Fit an ellipse around the origin to a rose plot, by weighted least squares of 1 / r^2.

    Where the fit is not an ellipse, as for the Hurst coefficients of noise, mean and second harmonic of the radii are
    used.

    Parameters
    ----------
    directions_deg : (d,) array
        Directions over 180 degrees, in degrees.
    radii : (d,) array, dimensionless
        Radius in each direction.

    Returns
    -------
    RoseEllipse
        Ellipse.
    """
    angles = 2 * np.deg2rad(directions_deg)
    kept = np.maximum(radii, _MIN_RADIUS)
    # 1 / r^2 = mean + cosine cos 2t + sine sin 2t is an ellipse. The weights r^3 give all radii the same error.
    basis = np.stack((np.ones(len(angles)), np.cos(angles), np.sin(angles)), axis=1)
    mean, cosine, sine = np.linalg.lstsq(basis * kept[:, None] ** 3, kept, rcond=None)[0]
    change = np.hypot(cosine, sine)
    if mean > change:
        ratio = np.sqrt((mean - change) / (mean + change))
    else:
        # No ellipse fits: the second harmonic of the radii is used.
        mean, cosine, sine = np.linalg.lstsq(basis, kept, rcond=None)[0] * (1.0, -1.0, -1.0)
        change = np.hypot(cosine, sine)
        ratio = max(mean - change, 0.0) / (mean + change)
    return RoseEllipse(
        aspect_ratio=float(ratio), orientation_deg=float(np.rad2deg(np.arctan2(-sine, -cosine)) / 2 % 180.0)
    )
