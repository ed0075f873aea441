"""Ordered crossings of rays with surfaces, and lengths and density integrals between crossings."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.numba_kernel import kernel
from ...geometry.density import Density, integrate_along_segments
from .projected_surface import RayFrame


class Window(NamedTuple):
    """Rectangle of pixels in an image.

    Attributes
    ----------
    row, col : int
        First row and first column.
    rows, cols : int
        Number of rows and columns.
    """

    row: int
    col: int
    rows: int
    cols: int


class Crossings(NamedTuple):
    """Crossings of one surface with the rays to a window of pixels.

    Attributes
    ----------
    window : Window
        Window of pixels at which the rays end.
    starts : (rows x cols + 1,) int64 array
        Index of the first crossing of each pixel; the last entry is the total number of crossings.
    depth : (n,) float64 array, dimensionless
        Distance from the source as a fraction of the source-to-pixel distance, in ascending order along each ray.
    sign : (n,) int8 array
        +1 where the ray leaves the surface, -1 where it enters.
    """

    window: Window
    starts: NDArray[np.int64]
    depth: Array
    sign: NDArray[np.int8]


class _Segments(NamedTuple):
    """Segments of rays inside a surface: end points (n, 3) in mm, pixels (n,) and weights (n,).

    The weight of a segment is the winding number of the surface around the segment, divided by the ray length in mm.
    """

    starts_mm: Array
    ends_mm: Array
    pixels: NDArray[np.int64]
    weights: Array


def allocate_crossings(window: Window, crossing_counts: NDArray[np.integer]) -> Crossings:
    """Allocate arrays for a known number of crossings per ray.

    Parameters
    ----------
    window : Window
        Window of pixels at which the rays end.
    crossing_counts : (rows, cols) integer array
        Number of crossings of each ray.

    Returns
    -------
    Crossings
        Crossings with complete `starts`; the values of `depth` and `sign` are not yet set.
    """
    starts = np.zeros(crossing_counts.size + 1, np.int64)
    np.cumsum(crossing_counts, out=starts[1:])
    return Crossings(window, starts, np.empty(starts[-1]), np.empty(starts[-1], np.int8))


def merge_crossings(parts: Sequence[tuple[Crossings, int]]) -> Crossings:
    """Merge the crossings of several surfaces into the crossings of one combined surface.

    The combined surface encloses the volume of all surfaces with factor +1, minus the volume of all surfaces with
    factor -1.

    Parameters
    ----------
    parts : sequence of (Crossings, int)
        Crossings of each surface, with the factor +1 or -1.

    Returns
    -------
    Crossings
        Crossings in the smallest window that contains all input windows, sorted by depth along each ray.
    """
    if len(parts) == 1 and parts[0][1] == 1:
        return parts[0][0]
    windows = np.array([part.window for part, _ in parts])
    low, high = windows[:, :2].min(axis=0), (windows[:, :2] + windows[:, 2:]).max(axis=0)
    number = np.zeros(high - low, np.int64)
    for (part, _), (row, col, rows, cols) in zip(parts, windows - [*low, 0, 0], strict=True):
        number[row : row + rows, col : col + cols] += np.diff(part.starts).reshape(rows, cols)
    whole = allocate_crossings(Window(*low.tolist(), *number.shape), number)
    free = whole.starts[:-1].copy()
    for part, factor in parts:
        _append_crossings(part, factor, free, whole)
    sort_crossings(whole.starts, whole.depth, whole.sign)
    return whole


def chord_fractions(crossings: Crossings) -> Array:
    """Compute the length of each ray inside a surface.

    Parameters
    ----------
    crossings : Crossings
        Crossings of rays with the surface.

    Returns
    -------
    (rows, cols) float64 array
        Lengths inside the surface, as fractions of the source-to-pixel distance.
    """
    out = np.empty((crossings.window.rows, crossings.window.cols))
    _sum_depths(crossings.starts, crossings.depth, crossings.sign, out.reshape(-1))
    return out


def integrate_along_rays(crossings: Crossings, frame: RayFrame, density: Density) -> Array:
    """Integrate a density along each ray inside a surface.

    Parameters
    ----------
    crossings : Crossings
        Crossings of rays with the surface.
    frame : RayFrame
        Source and pixels that define the rays.
    density : Density
        Relative density to integrate.

    Returns
    -------
    (rows, cols) float64 array
        Density integrals, as fractions of the source-to-pixel distance.

    Raises
    ------
    InputError
        If the density function does not return one finite number per segment.
    """
    window = crossings.window
    most = len(crossings.depth) + len(crossings.starts) - 1
    segments = _Segments(np.empty((most, 3)), np.empty((most, 3)), np.empty(most, np.int64), np.empty(most))
    count = _find_segments(crossings, frame, segments)
    lengths = integrate_along_segments(density, segments.starts_mm[:count], segments.ends_mm[:count])
    pixels, weights = segments.pixels[:count], segments.weights[:count]
    total = np.bincount(pixels, weights=weights * lengths, minlength=window.rows * window.cols)
    return np.asarray(total, dtype=np.float64).reshape(window.rows, window.cols)


@kernel()
def sort_crossings(starts: NDArray[np.int64], depth: Array, sign: NDArray[np.int8]) -> None:
    """Sort the crossings of each ray by depth, in place.

    Insertion sort is used, because each ray has few crossings.

    Parameters
    ----------
    starts : (pixels + 1,) int64 array
        Index of the first crossing of each pixel, as in `Crossings`.
    depth : (n,) float64 array, dimensionless
        Distance from the source as a fraction of the source-to-pixel distance; sorted in place.
    sign : (n,) int8 array
        +1 where the ray leaves the surface, -1 where it enters; sorted together with `depth`.
    """
    for pixel in range(len(starts) - 1):
        for k in range(starts[pixel] + 1, starts[pixel + 1]):
            d, s, n = depth[k], sign[k], k
            while n > starts[pixel] and depth[n - 1] > d:
                depth[n], sign[n] = depth[n - 1], sign[n - 1]
                n -= 1
            depth[n], sign[n] = d, s


@kernel()
def _append_crossings(part: Crossings, factor: int, next_slot: NDArray[np.int64], whole: Crossings) -> None:
    """Append the crossings of `part` to `whole`, with signs multiplied by `factor`.

    `next_slot` (pixels,) is the next free index of each pixel in `whole`; it is advanced in place.
    """
    cols = part.window.cols
    for pixel in range(len(part.starts) - 1):
        row = part.window.row - whole.window.row + pixel // cols
        place = row * whole.window.cols + part.window.col - whole.window.col + pixel % cols
        for k in range(part.starts[pixel], part.starts[pixel + 1]):
            n = next_slot[place]
            whole.depth[n], whole.sign[n] = part.depth[k], factor * part.sign[k]
            next_slot[place] = n + 1


@kernel()
def _sum_depths(starts: NDArray[np.int64], depth: Array, sign: NDArray[np.int8], out: Array) -> None:
    """Sum sign x depth over the crossings of each pixel into `out` (pixels,); the largest depth is 1, the detector."""
    for pixel in range(len(out)):
        total = 0.0
        for k in range(starts[pixel], starts[pixel + 1]):
            total += sign[k] * min(depth[k], 1.0)
        out[pixel] = total


@kernel()
def _find_segments(crossings: Crossings, frame: RayFrame, segments: _Segments) -> int:
    """Fill `segments` with the ray segments inside the surface and return their number."""
    count, window, source, starts_mm, ends_mm = 0, crossings.window, frame.source, segments.starts_mm, segments.ends_mm
    for pixel in range(len(crossings.starts) - 1):
        row, col = window.row + pixel // window.cols, window.col + pixel % window.cols
        x, y, z = (
            frame.corner_vector.x + col * frame.pixel_mm,
            frame.corner_vector.y,
            frame.corner_vector.z - row * frame.pixel_mm,
        )
        first, stop = crossings.starts[pixel], crossings.starts[pixel + 1]
        # A ray with more exits than entries starts inside the surface.
        inside, at = 0, 0.0
        for k in range(first, stop):
            inside += crossings.sign[k]
        for k in range(first, stop):
            end = min(crossings.depth[k], 1.0)
            if inside != 0 and end > at:
                starts_mm[count, 0], ends_mm[count, 0] = source.x + at * x, source.x + end * x
                starts_mm[count, 1], ends_mm[count, 1] = source.y + at * y, source.y + end * y
                starts_mm[count, 2], ends_mm[count, 2] = source.z + at * z, source.z + end * z
                segments.pixels[count], segments.weights[count] = pixel, inside / math.sqrt(x * x + y * y + z * z)
                count += 1
            inside -= crossings.sign[k]
            at = max(end, at)
    return count
