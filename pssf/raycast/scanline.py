"""Scanline engine: triangles are projected onto the detector and their depths accumulated per pixel, in float64.

Exact by construction. On a row, a triangle covers the columns between the crossings of two of its directed edges, one
going down and one going up. The triangle beyond an edge runs along it the other way and gets the same crossing, bit for
bit, so that the signs of a closed surface add up to zero at every pixel, for slivers and triangles seen edge-on too.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.checks import Array
from .crossings import Crossings, offsets, order
from .paths import Audit
from .sheets import Sheet


class Caster:
    """Casts all rays of a window that a surface can cover."""

    def __init__(self, sheet: Sheet, around: int) -> None:
        del around  # the signs come out right by construction
        self.sheet = sheet

    def chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """What `chords` gives, and its audit."""
        found = chords(self.sheet, first, stop)
        return found, Audit(rays=found.size)

    def crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """What `crossings` gives, and its audit."""
        found = crossings(self.sheet, first, stop)
        return found, Audit(rays=len(found.starts) - 1)


def chords(sheet: Sheet, first: int, stop: int) -> Array:
    """Chords within a surface, as fractions of the way from the source to the pixel.

    first, stop  half-open range of rows, inside one band
    returns      (stop - first, columns of the sheet)  sum over crossings of sign x depth, + on leaving, - on entering
    """
    return _accumulate(sheet, first, stop, sheet.depth)


def windings(sheet: Sheet, first: int, stop: int) -> Array:
    """(stop - first, columns of the sheet)  sums of the signs; one number all over on a surface that is closed"""
    # Depths are clamped to those of the vertices, so that with all vertices at 1 the sum is of the signs alone.
    return _accumulate(sheet, first, stop, np.ones_like(sheet.depth))


def counts(sheet: Sheet, first: int, stop: int) -> NDArray[np.int32]:
    """(stop - first, columns of the sheet)  how often each ray crosses a surface; rows as in `chords`"""
    steps = np.zeros((stop - first, sheet.cols[1] - sheet.cols[0] + 1), np.int32)
    _count(sheet.in_band(first), sheet.faces, sheet.seen, first, sheet.cols[0], steps)
    return np.cumsum(steps, axis=1, dtype=np.int32)[:, :-1]


def covering(sheet: Sheet) -> NDArray[np.int32]:
    """Triangles that hold the centre of a pixel: those whose crossings make up the image."""
    kept = np.zeros(len(sheet.faces), np.bool_)
    _mark(sheet.order, sheet.faces, sheet.seen, np.array((*sheet.rows, *sheet.cols)), kept)
    return np.flatnonzero(kept).astype(np.int32)


def crossings(sheet: Sheet, first: int, stop: int) -> Crossings:
    """Every crossing of the rows' rays with a surface, in order along each ray; rows as in `chords`"""
    number = counts(sheet, first, stop)
    starts = offsets(number)
    depth, sign = np.empty(starts[-1]), np.empty(starts[-1], np.int8)
    geometry = (sheet.faces, sheet.seen, sheet.depth, sheet.planes, sheet.frame)
    window = (first, sheet.cols[0], *number.shape)
    _list(sheet.in_band(first), *geometry, np.array(window), starts[:-1].copy(), depth, sign)
    order(starts, depth, sign)
    return Crossings(window=window, starts=starts, depth=depth, sign=sign)


def _accumulate(sheet: Sheet, first: int, stop: int, depth: Array) -> Array:
    sums = np.zeros((stop - first, sheet.cols[1] - sheet.cols[0]))
    _scan(sheet.in_band(first), sheet.faces, sheet.seen, depth, sheet.planes, sheet.frame, first, sheet.cols[0], sums)
    return sums


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _crossing(seen: Array, one: int, other: int, row: int) -> float:
    """Column at which an edge crosses a row; the same bits whichever way the edge is run along."""
    i, j = min(one, other), max(one, other)
    start, end = seen[i, 1], seen[j, 1]
    column = start + (row - seen[i, 0]) / (seen[j, 0] - seen[i, 0]) * (end - start)
    # Rounding must not carry it off the edge: triangles are left out of a band by the columns of their vertices.
    return min(max(column, min(start, end)), max(start, end))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _span(seen: Array, face: NDArray[np.int32], row: int) -> tuple[float, float]:
    """Columns at which a triangle's boundary crosses a row, going down and going up."""
    down, up = 0.0, 0.0
    for corner in range(3):
        one, other = face[corner], face[(corner + 1) % 3]
        # Half-open, so that a vertex on a pixel row belongs to one of its two edges.
        above, below = seen[one, 0] <= row, seen[other, 0] <= row
        if above and not below:
            down = _crossing(seen, one, other, row)
        elif below and not above:
            up = _crossing(seen, one, other, row)
    return down, up


@njit(cache=True, nogil=True, error_model="numpy")
def _scan(
    picked: NDArray[np.int32],
    faces: NDArray[np.int32],
    seen: Array,
    depth: Array,
    planes: Array,
    frame: Array,
    first_row: int,
    first_col: int,
    sums: Array,
) -> None:
    """Add sign x depth of the picked triangles to `sums` (rows, cols), whose pixel (0, 0) is (first_row, first_col)."""
    stop_row, stop_col = first_row + sums.shape[0], first_col + sums.shape[1]
    for k in picked:
        a, b, c = faces[k]
        # A triangle seen edge-on has no depth of its own at a pixel; between those of its vertices it stays in bounds.
        # A crossing behind the detector counts as one in its plane.
        low, high = min(depth[a], depth[b], depth[c], 1.0), min(max(depth[a], depth[b], depth[c]), 1.0)
        top = max(math.ceil(min(seen[a, 0], seen[b, 0], seen[c, 0])), first_row)
        bottom = min(math.ceil(max(seen[a, 0], seen[b, 0], seen[c, 0])), stop_row)
        x, y, z, scaled = planes[k]
        for row in range(top, bottom):
            down, up = _span(seen, faces[k], row)
            left, right = max(math.ceil(min(down, up)), first_col), min(math.ceil(max(down, up)), stop_col)
            sign = 1.0 if up < down else -1.0  # outward triangles that are seen from behind: there the ray leaves
            start = x * frame[3] + y * frame[4] + z * (frame[5] - row * frame[6])
            line = sums[row - first_row]
            for col in range(left, right):
                at = scaled / (start + x * (col * frame[6]))
                at = at if at > low else low  # this way round, so that 0/0 gives a bound too
                at = at if at < high else high
                line[col - first_col] += sign * at


@njit(cache=True, nogil=True, error_model="numpy")
def _count(
    picked: NDArray[np.int32],
    faces: NDArray[np.int32],
    seen: Array,
    first_row: int,
    first_col: int,
    steps: NDArray[np.int32],
) -> None:
    """Add to `steps` (rows, cols + 1) one where a picked triangle begins on a row, and take one where it has ended."""
    stop_row, stop_col = first_row + steps.shape[0], first_col + steps.shape[1] - 1
    for k in picked:
        a, b, c = faces[k]
        top = max(math.ceil(min(seen[a, 0], seen[b, 0], seen[c, 0])), first_row)
        bottom = min(math.ceil(max(seen[a, 0], seen[b, 0], seen[c, 0])), stop_row)
        for row in range(top, bottom):
            down, up = _span(seen, faces[k], row)
            left, right = max(math.ceil(min(down, up)), first_col), min(math.ceil(max(down, up)), stop_col)
            if left < right:
                steps[row - first_row, left - first_col] += 1
                steps[row - first_row, right - first_col] -= 1


@njit(cache=True, nogil=True, error_model="numpy")
def _mark(
    picked: NDArray[np.int32], faces: NDArray[np.int32], seen: Array, field: NDArray[np.int64], kept: NDArray[np.bool_]
) -> None:
    """Set `kept` of the picked triangles that hold a pixel of the field (first and stop row, first and stop column)."""
    for k in picked:
        if kept[k]:
            continue
        a, b, c = faces[k]
        top = max(math.ceil(min(seen[a, 0], seen[b, 0], seen[c, 0])), field[0])
        bottom = min(math.ceil(max(seen[a, 0], seen[b, 0], seen[c, 0])), field[1])
        for row in range(top, bottom):
            down, up = _span(seen, faces[k], row)
            if max(math.ceil(min(down, up)), field[2]) < min(math.ceil(max(down, up)), field[3]):
                kept[k] = True
                break


@njit(cache=True, nogil=True, error_model="numpy")
def _list(
    picked: NDArray[np.int32],
    faces: NDArray[np.int32],
    seen: Array,
    depth: Array,
    planes: Array,
    frame: Array,
    window: NDArray[np.int64],
    free: NDArray[np.int64],
    at: Array,
    sign: NDArray[np.int8],
) -> None:
    """Write every crossing of a window (row, column, rows, cols) to where `free` says, and move `free` on."""
    stop_row, stop_col = window[0] + window[2], window[1] + window[3]
    for k in picked:
        a, b, c = faces[k]
        low, high = min(depth[a], depth[b], depth[c]), max(depth[a], depth[b], depth[c])
        top = max(math.ceil(min(seen[a, 0], seen[b, 0], seen[c, 0])), window[0])
        bottom = min(math.ceil(max(seen[a, 0], seen[b, 0], seen[c, 0])), stop_row)
        x, y, z, scaled = planes[k]
        for row in range(top, bottom):
            down, up = _span(seen, faces[k], row)
            left, right = max(math.ceil(min(down, up)), window[1]), min(math.ceil(max(down, up)), stop_col)
            start = x * frame[3] + y * frame[4] + z * (frame[5] - row * frame[6])
            for col in range(left, right):
                found = scaled / (start + x * (col * frame[6]))
                found = found if found > low else low
                pixel = (row - window[0]) * window[3] + col - window[1]
                at[free[pixel]] = found if found < high else high
                sign[free[pixel]] = 1 if up < down else -1
                free[pixel] += 1
