"""Scales of texture measures in mm, and checks of images and masks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_in_range

# Scales of the default signature, in mm: factors of the cube root of 2 from 0.4 to 1.6. They include the trabecular
# sizes at which knees with osteoarthritis differed: 0.2 to 1.1 mm (Podsiadlo 2008) and 0.3 to 0.7 mm (Wolski 2010).
SCALES_MM = tuple(round(0.4 * 2 ** (k / 3), 3) for k in range(7))
# Smallest scale that is resolved, in pixels.
MIN_SCALE_PX = 2.0
# Number of pixels below which no texture is measured.
_MIN_PIXELS = 100


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


def prepare_region(
    image: NDArray[np.generic], pixel_mm: float, mask: NDArray[np.bool_] | None, scales_mm: Sequence[float]
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
        Scales, in mm, at least two and in increasing order.

    Returns
    -------
    TextureRegion
        Region.

    Raises
    ------
    InputError
        The image is not a matrix of finite numbers, is constant in the mask, or the mask has another shape or too few
        pixels; a scale is below two pixels or does not fit into the region.
    """
    require_in_range("pixel_mm", pixel_mm, 1e-3, 10.0, "mm")
    values = np.asarray(image, np.float64)
    if values.ndim != 2:
        raise InputError(f"image must have two dimensions, got shape {values.shape}")
    inside = np.ones(values.shape, np.bool_) if mask is None else np.asarray(mask, np.bool_)
    if inside.shape != values.shape:
        raise InputError(f"mask must have the shape of the image, {values.shape}, got {inside.shape}")
    if np.count_nonzero(inside) < _MIN_PIXELS:
        raise InputError(f"mask must have at least {_MIN_PIXELS} pixels, got {np.count_nonzero(inside)}")
    rows, cols = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    values, inside = values[box], inside[box]
    measured = values[inside]
    if not np.isfinite(measured).all():
        raise InputError(f"image must be finite in the mask, got {measured[~np.isfinite(measured)][0]}")
    if measured.max() == measured.min():
        raise InputError(f"image must vary in the mask, got {measured[0]:g} everywhere")
    scales_px = _check_scales(scales_mm, pixel_mm, min(inside.shape))
    return TextureRegion(values=np.where(inside, values - measured.mean(), 0.0), mask=inside, scales_px=scales_px)


def _check_scales(scales_mm: Sequence[float], pixel_mm: float, side_px: int) -> Array:
    """Return scales in pixels; raise InputError if they cannot be measured in a region of this shorter side."""
    scales = np.asarray(scales_mm, np.float64)
    if scales.ndim != 1 or len(scales) < 2 or (np.diff(scales) <= 0).any():
        raise InputError(f"scales_mm must be at least two increasing numbers, got {scales_mm}")
    scales_px = scales / pixel_mm
    # Rounding of decimal fractions must not refuse a scale of exactly two pixels.
    if scales_px[0] < MIN_SCALE_PX - 1e-6:
        raise InputError(f"scales_mm must be at least {MIN_SCALE_PX:g} pixels of {pixel_mm:g} mm, got {scales[0]:g} mm")
    if 2 * scales_px[-1] + 1 > side_px:
        raise InputError(
            f"scales_mm must be below half of the region of {side_px * pixel_mm:.1f} mm, got {scales[-1]:g} mm"
        )
    return scales_px
