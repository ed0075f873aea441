"""Variance and Hurst orientation transforms: fractal dimension by direction and scale."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from .directional_variogram import measure_variogram
from .rod_ranges import measure_rod_ranges
from .rose_ellipse import fit_ellipse
from .scaling_laws import fit_local_slopes, fit_slope
from .texture_scales import SCALES_MM, TextureRegion, prepare_region

# Directions over 180 degrees, in degrees. Both sets include 0 and 90 degrees.
_VARIANCE_DIRECTIONS = np.arange(0.0, 180.0, 5.0)
_RANGE_DIRECTIONS = np.arange(0.0, 180.0, 10.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientationSignature:
    """Fractal dimension by direction and scale, and the ellipse of the rose plot of Hurst coefficients.

    Attributes
    ----------
    scales_mm : (n,) array
        Scales, in mm: the given ones except the first and the last.
    directions_deg : (d,) array
        Directions over 180 degrees, in degrees counter-clockwise from the rows of the image.
    dimensions : (d, n) array
        Fractal dimension by direction and scale.
    direction_dimensions : (d,) array
        Fractal dimension over all scales, by direction.
    mean_dimension : float
        Mean over directions.
    horizontal_dimension, vertical_dimension : float
        Dimension along the rows and the columns.
    roughest_dimension : float
        Largest dimension of all directions.
    aspect_ratio : float
        Texture aspect ratio: minor divided by major axis of the ellipse of Hurst coefficients; 1 if isotropic.
        Hurst coefficients below 0.01 count as 0.01.
    orientation_deg : float
        Direction of the major axis, along which the texture is smoothest, in degrees, 0 to 180.
    aspect_ratios, orientations_deg : (n,) array
        Aspect ratio and orientation at each scale.
    """

    scales_mm: Array
    directions_deg: Array
    dimensions: Array
    direction_dimensions: Array
    mean_dimension: float
    horizontal_dimension: float
    vertical_dimension: float
    roughest_dimension: float
    aspect_ratio: float
    orientation_deg: float
    aspect_ratios: Array
    orientations_deg: Array


def variance_orientation_transform(
    image: NDArray[np.generic],
    *,
    pixel_mm: float,
    mask: NDArray[np.bool_] | None = None,
    scales_mm: Sequence[float] = SCALES_MM,
) -> OrientationSignature:
    """Measure the variance orientation transform of a region (Wolski 2009).

    The mean square of grey-value differences at the distance d is proportional to d^(2 H) for a fractional Brownian
    surface. The dimension is D = 3 - H. H follows by least squares of logarithms in 36 directions. Gain and offset of
    the grey values do not change D. The image is not smoothed or resampled.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array, optional
        True for the pixels to measure; None: all pixels.
    scales_mm : sequence of float, optional
        At least three distances, in mm, in increasing order, at least two pixels.

    Returns
    -------
    OrientationSignature
        Dimensions.

    Raises
    ------
    InputError
        The image, the mask or the scales cannot be measured; see `texture_scales.prepare_region`.

    References
    ----------
    Wolski M, Podsiadlo P, Stachowiak GW (2009). Directional fractal signature analysis of trabecular bone: evaluation
    of different methods to detect early osteoarthritis in knee radiographs. Proc Inst Mech Eng H 223:211.

    Wolski M,
    Podsiadlo P, Stachowiak GW (2014). Directional fractal signature methods for trabecular bone texture in hand
    radiographs. Med Phys 41:081914.

    Examples
    --------
    >>> lines = np.cumsum(np.random.default_rng(1).normal(size=(300, 300)), axis=1)
    >>> texture = variance_orientation_transform(lines, pixel_mm=0.2)
    >>> round(texture.horizontal_dimension, 1)
    2.5
    """
    region = prepare_region(image, pixel_mm, mask, scales_mm)
    variances = measure_variogram(region, _VARIANCE_DIRECTIONS)
    return _make_signature(_VARIANCE_DIRECTIONS, np.asarray(scales_mm, np.float64), np.sqrt(variances))


def hurst_orientation_transform(
    image: NDArray[np.generic],
    *,
    pixel_mm: float,
    mask: NDArray[np.bool_] | None = None,
    scales_mm: Sequence[float] = SCALES_MM,
) -> OrientationSignature:
    """Measure the Hurst orientation transform of a region (Podsiadlo and Stachowiak 2002).

    The mean range of grey values along a line of the half-length r is proportional to r^H for a fractional Brownian
    surface. The dimension is D = 3 - H. H follows by least squares of logarithms in 18 directions. Gain and offset of
    the grey values do not change D. The image is not smoothed or resampled.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array, optional
        True for the pixels to measure; None: all pixels.
    scales_mm : sequence of float, optional
        At least three half-lengths of lines, in mm, in increasing order, at least two pixels.

    Returns
    -------
    OrientationSignature
        Dimensions.

    Raises
    ------
    InputError
        The image, the mask or the scales cannot be measured; see `texture_scales.prepare_region`.

    References
    ----------
    Podsiadlo P, Stachowiak GW (2002). Analysis of trabecular bone texture by modified Hurst orientation transform
    method. Med Phys 29:460.

    Examples
    --------
    >>> lines = np.cumsum(np.random.default_rng(1).normal(size=(300, 300)), axis=1)
    >>> texture = hurst_orientation_transform(lines, pixel_mm=0.2)
    >>> round(texture.horizontal_dimension, 1)
    2.4
    """
    region = prepare_region(image, pixel_mm, mask, scales_mm)
    ranges = np.stack([_measure_ranges(region, angle) for angle in _RANGE_DIRECTIONS])
    return _make_signature(_RANGE_DIRECTIONS, np.asarray(scales_mm, np.float64), ranges)


def _measure_ranges(region: TextureRegion, direction_deg: float) -> Array:
    """Measure the mean range along lines in one direction, at each scale (n,)."""
    lengths, ranges = measure_rod_ranges(region, direction_deg)
    return np.asarray(np.exp(np.interp(np.log(region.scales_px), np.log(lengths), np.log(ranges))))


def _make_signature(directions_deg: Array, scales_mm: Array, amplitudes: Array) -> OrientationSignature:
    """Make a signature from amplitudes (directions, scales) that are proportional to scale^H."""
    by_scale = fit_local_slopes(scales_mm, amplitudes)
    over_all = fit_slope(scales_mm, amplitudes)
    dimensions = 3.0 - over_all
    ellipse = fit_ellipse(directions_deg, over_all)
    ellipses = [fit_ellipse(directions_deg, of_scale) for of_scale in by_scale.T]
    return OrientationSignature(
        scales_mm=scales_mm[1:-1],
        directions_deg=directions_deg,
        dimensions=3.0 - by_scale,
        direction_dimensions=dimensions,
        mean_dimension=float(dimensions.mean()),
        horizontal_dimension=float(dimensions[0]),
        vertical_dimension=float(dimensions[len(dimensions) // 2]),
        roughest_dimension=float(dimensions.max()),
        aspect_ratio=ellipse.aspect_ratio,
        orientation_deg=ellipse.orientation_deg,
        aspect_ratios=np.array([one.aspect_ratio for one in ellipses]),
        orientations_deg=np.array([one.orientation_deg for one in ellipses]),
    )
