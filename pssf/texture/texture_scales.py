"""Scales of texture measures in mm, and checks of images and masks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_in_range

# Scales of the default signature, in mm: factors of the cube root of 2 from 0.4 to 1.6. They overlap with the
# trabecular sizes at which knees with osteoarthritis differed: 0.2 to 1.1 mm (Podsiadlo 2008) and 0.3 to 0.7 mm
# (Wolski 2010).
SCALES_MM = tuple(round(0.4 * 2 ** (k / 3), 3) for k in range(7))
# Smallest scale that is resolved, in pixels.
MIN_SCALE_PX = 2.0
# Relative tolerance of this limit: rounding of decimal fractions must not reject a scale of exactly two pixels.
_TOLERANCE = 1e-6
# Number of pixels below which no texture is measured.
_MIN_PIXELS = 100


class UnmeasurableTextureError(InputError):
    """A region is too small, or its grey values do not vary, so that its texture cannot be measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TextureRegion:
    """Grey values of a region, cut to the bounding box of its mask.

    Attributes
    ----------
    values : (rows, cols) array
        Grey values, with mean 0 over the mask; 0 outside.
    mask : (rows, cols) bool array
        True for pixels that are measured.
    scales_px : (n,) array
        Scales, in pixels, in increasing order.
    """

    values: Array
    mask: NDArray[np.bool_]
    scales_px: Array


def is_resolved(scale_mm: float, pixel_mm: float) -> bool:
    """Report whether a scale has at least two pixels.

    Parameters
    ----------
    scale_mm : float
        Scale, in mm.
    pixel_mm : float
        Pixel size, in mm.

    Returns
    -------
    bool
        True if pixels of this size resolve the scale.
    """
    return scale_mm >= MIN_SCALE_PX * pixel_mm * (1 - _TOLERANCE)


def prepare_region(
    image: NDArray[np.generic],
    pixel_mm: float,
    mask: NDArray[np.bool_] | None,
    scales_mm: Sequence[float],
    *,
    name: str = "scales_mm",
    fewest: int = 3,
) -> TextureRegion:
    """Check an image and its mask, and cut the image to the mask.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array or None
        True for the pixels to measure; None: all pixels.
    scales_mm : sequence of float
        Scales, in mm, in increasing order.
    name : str, default "scales_mm"
        Name of the scales in messages.
    fewest : int, default 3
        Smallest number of scales.

    Returns
    -------
    TextureRegion
        Region.

    Raises
    ------
    InputError
        The image is not a matrix, the mask has another shape, or a scale is below two pixels.
    UnmeasurableTextureError
        The grey values are not finite or constant, or the region has too few pixels or is too small for a scale.
    """
    require_in_range("pixel_mm", pixel_mm, 1e-3, 10.0, "mm")
    values = np.asarray(image, np.float64)
    if values.ndim != 2:
        raise InputError(f"image must have two dimensions, got shape {values.shape}")
    inside = np.ones(values.shape, np.bool_) if mask is None else np.asarray(mask, np.bool_)
    if inside.shape != values.shape:
        raise InputError(f"mask must have the shape of the image, {values.shape}, got {inside.shape}")
    scales_px = _convert_scales(scales_mm, pixel_mm, name, fewest)
    if np.count_nonzero(inside) < _MIN_PIXELS:
        raise UnmeasurableTextureError(f"mask must have at least {_MIN_PIXELS} pixels, got {np.count_nonzero(inside)}")
    rows, cols = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    values, inside = values[box], inside[box]
    measured = values[inside]
    if not np.isfinite(measured).all():
        raise UnmeasurableTextureError(f"image must be finite in the mask, got {measured[~np.isfinite(measured)][0]}")
    if measured.max() == measured.min():
        raise UnmeasurableTextureError(f"image must vary in the mask, got {measured[0]:g} everywhere")
    if 2 * scales_px[-1] + 1 > min(inside.shape):
        raise UnmeasurableTextureError(
            f"{name} must be below half of the region of {min(inside.shape) * pixel_mm:.1f} mm, "
            f"got {scales_mm[-1]:g} mm"
        )
    return TextureRegion(values=np.where(inside, values - measured.mean(), 0.0), mask=inside, scales_px=scales_px)


def _convert_scales(scales_mm: Sequence[float], pixel_mm: float, name: str, fewest: int) -> Array:
    """Return scales (n,) in pixels; raise InputError if they are not increasing or not resolved."""
    scales = np.asarray(scales_mm, np.float64)
    if scales.ndim != 1 or len(scales) < fewest or not np.isfinite(scales).all() or (np.diff(scales) <= 0).any():
        raise InputError(f"{name} must be at least {fewest} increasing numbers, got {scales_mm}")
    if not is_resolved(float(scales[0]), pixel_mm):
        raise InputError(f"{name} must be at least {MIN_SCALE_PX:g} pixels of {pixel_mm:g} mm, got {scales[0]:g} mm")
    return scales / pixel_mm
