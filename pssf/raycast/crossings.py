"""Where rays cross a surface, in order along each ray: lengths between them, and integrals of a density."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import kernel
from ..geometry.density import Density, integrated
from .sheets import Frame


class Window(NamedTuple):
    """Pixels of an image: the first row and column, and how many rows and columns."""

    row: int
    col: int
    rows: int
    cols: int


class Crossings(NamedTuple):
    """Crossings of a window of pixels with one surface.

    starts  (rows x cols + 1,)  where the crossings of each pixel's ray start below; the last is their number
    depth   (n,)  fraction of the way from the source to the pixel, growing along a ray
    sign    (n,)  int8  +1 where the ray leaves, -1 where it enters
    """

    window: Window
    starts: NDArray[np.int64]
    depth: Array
    sign: NDArray[np.int8]


class _Segments(NamedTuple):
    """Parts of rays inside a surface, mm, their pixels, and how often they are inside over the ray's length."""

    starts_mm: Array
    ends_mm: Array
    pixels: NDArray[np.int64]
    weights: Array


def room_for(window: Window, number: NDArray[np.integer]) -> Crossings:
    """Crossings of which only the numbers are known yet

    number  (rows, cols)  how often each ray crosses the surface
    """
    starts = np.zeros(number.size + 1, np.int64)
    np.cumsum(number, out=starts[1:])
    return Crossings(window, starts, np.empty(starts[-1]), np.empty(starts[-1], np.int8))


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
    whole = room_for(Window(*low.tolist(), *number.shape), number)
    free = whole.starts[:-1].copy()
    for part, factor in parts:
        _append(part, factor, free, whole)
    order(whole.starts, whole.depth, whole.sign)
    return whole


def chords(crossings: Crossings) -> Array:
    """(rows, cols)  lengths inside, as fractions of the way from the source to the pixel"""
    out = np.empty((crossings.window.rows, crossings.window.cols))
    _sum_depths(crossings.starts, crossings.depth, crossings.sign, out.reshape(-1))
    return out


def integrals(crossings: Crossings, frame: Frame, density: Density) -> Array:
    """(rows, cols)  integrals of a density inside, as fractions of the way from the source to the pixel"""
    window = crossings.window
    most = len(crossings.depth) + len(crossings.starts) - 1
    segments = _Segments(np.empty((most, 3)), np.empty((most, 3)), np.empty(most, np.int64), np.empty(most))
    count = _segments(crossings, frame, segments)
    lengths = integrated(density, segments.starts_mm[:count], segments.ends_mm[:count])
    pixels, weights = segments.pixels[:count], segments.weights[:count]
    total = np.bincount(pixels, weights=weights * lengths, minlength=window.rows * window.cols)
    return np.asarray(total, dtype=np.float64).reshape(window.rows, window.cols)


@kernel()
def order(starts: NDArray[np.int64], depth: Array, sign: NDArray[np.int8]) -> None:
    """Order the crossings of each ray by depth, in place; rays have few.

    starts, depth, sign  (pixels + 1,), (n,), (n,)  as in Crossings; depth a share of the way
    """
    for pixel in range(len(starts) - 1):
        for k in range(starts[pixel] + 1, starts[pixel + 1]):
            d, s, n = depth[k], sign[k], k
            while n > starts[pixel] and depth[n - 1] > d:
                depth[n], sign[n] = depth[n - 1], sign[n - 1]
                n -= 1
            depth[n], sign[n] = d, s


@kernel()
def _append(part: Crossings, factor: int, free: NDArray[np.int64], whole: Crossings) -> None:
    """Write the crossings of a part, times a factor, to where `free` says for each pixel of the whole; move it on."""
    cols = part.window.cols
    for pixel in range(len(part.starts) - 1):
        row = part.window.row - whole.window.row + pixel // cols
        place = row * whole.window.cols + part.window.col - whole.window.col + pixel % cols
        for k in range(part.starts[pixel], part.starts[pixel + 1]):
            n = free[place]
            whole.depth[n], whole.sign[n] = part.depth[k], factor * part.sign[k]
            free[place] = n + 1


@kernel()
def _sum_depths(starts: NDArray[np.int64], depth: Array, sign: NDArray[np.int8], out: Array) -> None:
    for pixel in range(len(out)):
        total = 0.0
        for k in range(starts[pixel], starts[pixel + 1]):
            total += sign[k] * min(depth[k], 1.0)
        out[pixel] = total


@kernel()
def _segments(crossings: Crossings, frame: Frame, segments: _Segments) -> int:
    """Fill in the segments of rays inside; returns their count."""
    count, window, source, starts_mm, ends_mm = 0, crossings.window, frame.source, segments.starts_mm, segments.ends_mm
    for pixel in range(len(crossings.starts) - 1):
        row, col = window.row + pixel // window.cols, window.col + pixel % window.cols
        x, y, z = frame.way.x + col * frame.pixel_mm, frame.way.y, frame.way.z - row * frame.pixel_mm
        first, stop = crossings.starts[pixel], crossings.starts[pixel + 1]
        # Who leaves more often than he enters was inside from the start.
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
