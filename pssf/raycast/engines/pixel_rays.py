"""Rays from the source to the pixels: direction, length, and length inside a box."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from .projected_surface import RayFrame


def ray_vectors_mm(frame: RayFrame, rows: NDArray[np.integer], cols: NDArray[np.integer]) -> tuple[Array, float, Array]:
    """Compute the vectors from the source to pixel centres.

    Parameters
    ----------
    frame : RayFrame
        Source and pixels that define the rays.
    rows, cols : (n,) and (m,) integer array
        Row numbers and column numbers of the pixels.

    Returns
    -------
    x : (m,) float64 array
        Horizontal component for each column, in mm.
    y : float
        Component along the beam, the same for all pixels, in mm.
    z : (n,) float64 array
        Vertical component for each row, in mm.
    """
    x, z = frame.corner_vector.x + cols * frame.pixel_mm, frame.corner_vector.z - rows * frame.pixel_mm
    return np.asarray(x, np.float64), frame.corner_vector.y, np.asarray(z, np.float64)


def add_box_path(frame: RayFrame, bounds_mm: Array, first_row: int, fraction: Array) -> None:
    """Add the length of each ray inside an axis-parallel box, as a fraction of the source-to-pixel distance.

    Parameters
    ----------
    frame : RayFrame
        Source and pixels that define the rays.
    bounds_mm : (2, 3) array, mm
        Lower and upper corner of the box.
    first_row : int
        Image row that corresponds to the first row of `fraction`.
    fraction : (rows, cols) float64 array, dimensionless
        Path length as a fraction of the source-to-pixel distance; the length inside the box is added in place.
    """
    x, y, z = ray_vectors_mm(frame, first_row + np.arange(fraction.shape[0]), np.arange(fraction.shape[1]))
    ways = x, np.array([y]), z[:, None]
    slabs = [_slab_interval(*each) for each in zip(bounds_mm[0], bounds_mm[1], frame.source, ways, strict=True)]
    near, far = (np.maximum(slabs[0][0], slabs[1][0]), np.minimum(slabs[0][1], slabs[1][1]))
    fraction += np.maximum(np.minimum(far, slabs[2][1]) - np.maximum(near, slabs[2][0]), 0.0)


def convert_to_mm(fraction: Array, frame: RayFrame, first_row: int) -> Array:
    """Convert fractions of the source-to-pixel distance to millimetres.

    Parameters
    ----------
    fraction : (rows, cols) float64 array, dimensionless
        Path length as a fraction of the source-to-pixel distance.
    frame : RayFrame
        Source and pixels that define the rays.
    first_row : int
        Image row that corresponds to the first row of `fraction`.

    Returns
    -------
    (rows, cols) float64 array
        Lengths in mm.
    """
    return np.asarray(fraction * _ray_lengths_mm(frame, first_row, *fraction.shape))


@lru_cache(maxsize=8)  # All materials of a band use the same ray lengths.
def _ray_lengths_mm(frame: RayFrame, first_row: int, rows: int, cols: int) -> Array:
    """Compute the distance from the source to each pixel (rows, cols), in mm."""
    x, y, z = ray_vectors_mm(frame, first_row + np.arange(rows), np.arange(cols))
    return np.asarray(np.sqrt(x * x + y * y + (z * z)[:, None]))


def _slab_interval(low: float, high: float, source: float, way: Array) -> tuple[Array, Array]:
    """Compute the fractions of the ray length at which rays enter and leave a slab, clipped to the range 0 to 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - source) / way, (high - source) / way
    near, far = np.maximum(np.minimum(one, other), 0.0), np.minimum(np.maximum(one, other), 1.0)
    # A ray parallel to the slab is inside if its source coordinate is in the half-open range [low, high).
    near[way == 0], far[way == 0] = (0.0, 1.0) if low <= source < high else (1.0, 0.0)
    return near, far
