"""Where rays cross a surface, in order along each ray: lengths between them, and integrals of a density."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.density import Density, integrated


@dataclass(frozen=True, kw_only=True)
class Crossings:
    """Crossings of a window of pixels with one surface.

    window  first row, first column, rows, columns
    starts  (rows x cols + 1,)  where the crossings of each pixel's ray start below; the last is their number
    depth   (n,)  fraction of the way from the source to the pixel, growing along a ray
    sign    (n,)  int8  +1 where the ray leaves, -1 where it enters
    """

    window: tuple[int, int, int, int]
    starts: NDArray[np.int64]
    depth: Array
    sign: NDArray[np.int8]


def offsets(number: NDArray[np.integer]) -> NDArray[np.int64]:
    """(pixels + 1,)  where each pixel's crossings start if those of all are put in one row"""
    starts = np.zeros(number.size + 1, np.int64)
    np.cumsum(number, out=starts[1:])
    return starts


def joined(parts: Sequence[tuple[Crossings, int]]) -> Crossings:
    """Crossings of several surfaces as if of one, around what is in the first, without what is in those with factor -1.

    parts  crossings, each with +1 or -1
    """
    if len(parts) == 1 and parts[0][1] == 1:
        return parts[0][0]
    windows = np.array([part.window for part, _ in parts])
    low, high = windows[:, :2].min(axis=0), (windows[:, :2] + windows[:, 2:]).max(axis=0)
    number = np.zeros(high - low, np.int64)
    for (part, _), (row, col, rows, cols) in zip(parts, windows - [*low, 0, 0], strict=True):
        number[row : row + rows, col : col + cols] += np.diff(part.starts).reshape(rows, cols)
    starts = offsets(number)
    depth, sign, free = np.empty(starts[-1]), np.empty(starts[-1], np.int8), starts[:-1].copy().reshape(number.shape)
    for (part, factor), window in zip(parts, windows - [*low, 0, 0], strict=True):
        _append(part.starts, part.depth, part.sign, factor, window, free, depth, sign)
    order(starts, depth, sign)
    return Crossings(window=(int(low[0]), int(low[1]), *number.shape), starts=starts, depth=depth, sign=sign)


def chords(crossings: Crossings) -> Array:
    """(rows, cols)  lengths inside, as fractions of the way from the source to the pixel"""
    out = np.empty(crossings.window[2:])
    _sum_depths(crossings.starts, crossings.depth, crossings.sign, out.reshape(-1))
    return out


def integrals(crossings: Crossings, frame: Array, density: Density) -> Array:
    """(rows, cols)  integrals of a density inside, as fractions of the way from the source to the pixel

    frame  as in a Sheet
    """
    window = np.array(crossings.window)
    most = len(crossings.depth) + len(crossings.starts) - 1
    starts_mm, ends_mm, pixels = np.empty((most, 3)), np.empty((most, 3)), np.empty(most, np.int64)
    weights = np.empty(most)
    ways = (crossings.starts, crossings.depth, crossings.sign, frame, window)
    count = _segments(*ways, starts_mm, ends_mm, pixels, weights)
    lengths = integrated(density, starts_mm[:count], ends_mm[:count])
    total = np.bincount(pixels[:count], weights=weights[:count] * lengths, minlength=window[2] * window[3])
    return np.asarray(total, dtype=np.float64).reshape(crossings.window[2:])


@njit(cache=True, nogil=True)
def order(starts: NDArray[np.int64], depth: Array, sign: NDArray[np.int8]) -> None:
    """Order the crossings of each ray by depth, in place; rays have few."""
    for pixel in range(len(starts) - 1):
        for k in range(starts[pixel] + 1, starts[pixel + 1]):
            d, s, n = depth[k], sign[k], k
            while n > starts[pixel] and depth[n - 1] > d:
                depth[n], sign[n] = depth[n - 1], sign[n - 1]
                n -= 1
            depth[n], sign[n] = d, s


@njit(cache=True, nogil=True)
def _append(
    starts: NDArray[np.int64],
    depth: Array,
    sign: NDArray[np.int8],
    factor: int,
    window: NDArray[np.int64],
    free: NDArray[np.int64],
    to_depth: Array,
    to_sign: NDArray[np.int8],
) -> None:
    """Write the crossings of a window (first row, first column, rows, columns) to where `free` says, and move it on."""
    for pixel in range(len(starts) - 1):
        row, col = window[0] + pixel // window[3], window[1] + pixel % window[3]
        for k in range(starts[pixel], starts[pixel + 1]):
            to_depth[free[row, col]], to_sign[free[row, col]] = depth[k], factor * sign[k]
            free[row, col] += 1


@njit(cache=True, nogil=True)
def _sum_depths(starts: NDArray[np.int64], depth: Array, sign: NDArray[np.int8], out: Array) -> None:
    for pixel in range(len(out)):
        total = 0.0
        for k in range(starts[pixel], starts[pixel + 1]):
            total += sign[k] * min(depth[k], 1.0)
        out[pixel] = total


@njit(cache=True, nogil=True)
def _segments(
    starts: NDArray[np.int64],
    depth: Array,
    sign: NDArray[np.int8],
    frame: Array,
    window: NDArray[np.int64],
    starts_mm: Array,
    ends_mm: Array,
    pixels: NDArray[np.int64],
    weights: Array,
) -> int:
    """Segments of rays inside, with their pixel and how often they are inside over the ray's length; their count."""
    count = 0
    for pixel in range(len(starts) - 1):
        row, col = window[0] + pixel // window[3], window[1] + pixel % window[3]
        x, y, z = frame[3] + col * frame[6], frame[4], frame[5] - row * frame[6]
        length = math.sqrt(x * x + y * y + z * z)
        # Who leaves more often than he enters was inside from the start.
        inside, at = 0, 0.0
        for k in range(starts[pixel], starts[pixel + 1]):
            inside += sign[k]
        for k in range(starts[pixel], starts[pixel + 1]):
            end = min(depth[k], 1.0)
            if inside != 0 and end > at:
                for axis, way in enumerate((x, y, z)):
                    starts_mm[count, axis] = frame[axis] + at * way
                    ends_mm[count, axis] = frame[axis] + end * way
                pixels[count], weights[count] = pixel, inside / length
                count += 1
            inside -= sign[k]
            at = max(end, at)
    return count
