"""Ellipse of a rose plot."""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array

# Smallest radius of a rose plot that is fitted; Hurst coefficients of noise may be below 0.
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
    """Fit an ellipse around the origin to a rose plot, by least squares of the equation of the conic.

    Parameters
    ----------
    directions_deg : (d,) array
        Directions over 180 degrees, in degrees.
    radii : (d,) array, dimensionless
        Radius in each direction.

    Returns
    -------
    RoseEllipse
        Ellipse; both values are NaN if the conic is not an ellipse.
    """
    angles = np.deg2rad(directions_deg)
    kept = np.maximum(radii, _MIN_RADIUS)
    x, y = kept * np.cos(angles), kept * np.sin(angles)
    (a, b, c), *_ = np.linalg.lstsq(np.stack((x * x, 2 * x * y, y * y), axis=1), np.ones(len(x)), rcond=None)
    of_axes, axes = np.linalg.eigh(np.array([[a, b], [b, c]]))
    if of_axes[0] <= 0:
        return RoseEllipse(aspect_ratio=np.nan, orientation_deg=np.nan)
    major = axes[:, 0]
    return RoseEllipse(
        aspect_ratio=float(np.sqrt(of_axes[0] / of_axes[1])),
        orientation_deg=float(np.rad2deg(np.arctan2(major[1], major[0])) % 180.0),
    )
