"""Rays from the source to the pixels: their lengths, where they meet a box, and where they start there.

`frame` is that of a Sheet. Compiled functions that call each other stand in one module: the cache of compiled code
notices changes in the module of the caller only.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.checks import Array


@njit(cache=True, nogil=True)
def add_box(frame: Array, bounds: Array, first: int, fraction: Array) -> None:
    """Add the part of each ray inside a box (2, 3) to `fraction` (rows, cols), which starts at row `first`."""
    for row in range(fraction.shape[0]):
        for col in range(fraction.shape[1]):
            near, far = _box_span(frame, bounds[0], bounds[1], first + row, col, 1.0)
            fraction[row, col] += max(far - near, 0.0)


@njit(cache=True, nogil=True)
def to_mm(fraction: Array, frame: Array, first: int, path_mm: NDArray[np.floating]) -> None:
    """Fractions of the way from source to pixel (rows, cols) times its length, into `path_mm` (rows, cols)."""
    for row in range(fraction.shape[0]):
        z = frame[5] - (first + row) * frame[6]
        for col in range(fraction.shape[1]):
            x = frame[3] + col * frame[6]
            path_mm[row, col] = fraction[row, col] * np.sqrt(x * x + frame[4] * frame[4] + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def start(
    frame: Array,
    centre: Array,
    low: Array,
    high: Array,
    window: NDArray[np.int64],
    left: NDArray[np.int32],
    doubt: NDArray[np.bool_],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    pixels: NDArray[np.int32],
    depths: Array,
    ends: Array,
    triangles: NDArray[np.int32],
    again: NDArray[np.int32],
    stride: int,
    between: bool,
) -> int:
    """Put the rays of a window (first row, first column, rows, columns) where they enter the box; returns their count.

    left    crossings of each pixel's ray; one without any is left out, and one with a single one comes from behind
    doubt   set where a ray with crossings misses the box, which rounding alone can bring about
    stride  of every so many columns alone; or, `between`, of the others
    """
    count = 0
    for pixel in range(len(left)):
        if left[pixel] == 0 or (pixel % window[3] % stride > 0) != between:
            continue
        row, col = window[0] + pixel // window[3], window[1] + pixel % window[3]
        near, far = _box_span(frame, low, high, row, col, np.inf)
        if near >= far:
            doubt[pixel] = True
            continue
        way = frame[3] + col * frame[6], frame[4], frame[5] - row * frame[6]
        length = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
        at, turn = (far, -1.0 / length) if left[pixel] == 1 else (near, 1.0 / length)
        for axis in range(3):
            origins[count, axis] = frame[axis] - centre[axis] + at * way[axis]
            directions[count, axis] = turn * way[axis]
        pixels[count], depths[count], ends[count], triangles[count], again[count] = pixel, 0.0, far, -1, 0
        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _box_span(frame: Array, low: Array, high: Array, row: int, col: int, limit: float) -> tuple[float, float]:
    """Depths, up to `limit`, at which a ray enters and leaves an axis-parallel box; it misses if it leaves first."""
    near, far = 0.0, limit
    for axis in range(3):
        way = frame[3 + axis]
        if axis == 0:
            way += col * frame[6]
        elif axis == 2:
            way -= row * frame[6]
        if way == 0.0:
            # Parallel to the slab: its lower side counts as inside and its upper one as outside.
            if not low[axis] <= frame[axis] < high[axis]:
                return 1.0, 0.0
            continue
        one, other = (low[axis] - frame[axis]) / way, (high[axis] - frame[axis]) / way
        near = max(near, min(one, other))
        far = min(far, max(one, other))
    return near, far
