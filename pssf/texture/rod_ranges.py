"""Mean range of grey values along rods: the difference of dilation and erosion with a linear structuring element."""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from .texture_scales import TextureRegion, UnmeasurableTextureError


def measure_rod_ranges(region: TextureRegion, direction_deg: float) -> tuple[Array, Array]:
    """Measure the mean difference of dilation and erosion with rods of increasing length in one direction.

    A rod of the half-length r consists of the pixels nearest to the points at the distances -r to r from its centre.
    All lengths are measured at the same centres: those at which the longest rod is inside the mask.

    Parameters
    ----------
    region : TextureRegion
        Region.
    direction_deg : float
        Direction of the rod, in degrees counter-clockwise from the rows of the image.

    Returns
    -------
    lengths_px : (m,) array
        Half-lengths of the rods, in pixels, up to at least the largest scale of the region, and half a pixel more
        along rows and columns.
    ranges : (m,) array
        Mean range for each half-length, in grey values.

    Raises
    ------
    UnmeasurableTextureError
        The longest rod fits nowhere into the mask, or the grey values are constant along all rods.
    """
    offsets = _list_offsets(direction_deg, region.scales_px[-1] + 0.75)
    reach = np.abs(offsets).max(axis=0)
    padded = np.pad(region.values, [(side, side) for side in reach])
    mask = np.pad(region.mask, [(side, side) for side in reach])
    shape = region.values.shape
    high, low, fits = region.values.copy(), region.values.copy(), region.mask.copy()
    ranges = np.empty((len(offsets), *shape))
    for index, offset in enumerate(offsets):
        for sign in (-1, 1):
            start = reach + sign * offset
            part = np.s_[start[0] : start[0] + shape[0], start[1] : start[1] + shape[1]]
            np.maximum(high, padded[part], out=high)
            np.minimum(low, padded[part], out=low)
            fits &= mask[part]
        np.subtract(high, low, out=ranges[index])
    if not fits.any():
        raise UnmeasurableTextureError(
            f"mask must contain rods of {2 * len(offsets) + 1} pixels at {direction_deg:g} degrees, got none"
        )
    means = ranges[:, fits].mean(axis=1)
    if means[0] <= 0:
        raise UnmeasurableTextureError(
            f"image must vary along rods at {direction_deg:g} degrees, got a range of {means[0]:g}"
        )
    return np.hypot(*offsets.T), means


def _list_offsets(direction_deg: float, reach_px: float) -> NDArray[np.int_]:
    """List the whole displacements (n, 2) that are nearest to a line from its centre, with increasing length."""
    angle = np.deg2rad(direction_deg)
    steps = np.arange(1, int(np.ceil(reach_px)) + 1)
    # Rounding of sines and cosines must not decide between two pixels that are equally near, as at 30 and 60 degrees.
    places = np.outer(steps, (-np.sin(angle), np.cos(angle))).round(9)
    offsets = np.rint(places).astype(int)
    return offsets[np.r_[True, (np.diff(offsets, axis=0) != 0).any(axis=1)]]
