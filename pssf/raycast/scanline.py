"""Scanline engine: triangles are projected onto the detector and their depths accumulated per pixel, in float64.

Exact by construction. On a row, a triangle covers the columns between the crossings of two of its directed edges, one
going down and one going up. The triangle beyond an edge runs along it the other way and gets the same crossing, bit for
bit, so that the signs of a closed surface add up to zero at every pixel, for slivers and triangles seen edge-on too.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel
from .crossings import Crossings, Window, order, room_for
from .paths import Audit
from .sheets import Frame, Sheet, Triangles

Ints = NDArray[np.int32]


class Caster:
    """Casts all rays of a window that a surface can cover."""

    def __init__(self, sheet: Sheet, around: int) -> None:
        del around  # the signs come out right by construction
        self.sheet = sheet

    def chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """What `chords` gives, and its audit."""
        lengths = chords(self.sheet, first, stop)
        return lengths, Audit(rays=lengths.size)

    def crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """What `crossings` gives, and its audit."""
        listed = crossings(self.sheet, first, stop)
        return listed, Audit(rays=len(listed.starts) - 1)


class _Spans(NamedTuple):
    """Runs of pixels, each on one row and within one triangle, all (n,).

    triangle, row  numbers
    left, right    half-open range of columns
    sign           +1 where the triangle is seen from behind, so that rays leave, -1 where they enter
    """

    triangle: Ints
    row: Ints
    left: Ints
    right: Ints
    sign: Ints


def chords(sheet: Sheet, first: int, stop: int) -> Array:
    """Chords within a surface, as fractions of the way from the source to the pixel.

    first, stop  half-open range of rows, inside one band
    returns      (stop - first, columns of the sheet)  sum over crossings of sign x depth, + on leaving, - on entering
    """
    window = _window(sheet, first, stop)
    sums = np.zeros((window.rows, window.cols))
    _scan(_spans(sheet, sheet.in_band(first), window)[0], sheet.triangles, sheet.frame, window, sums)
    return sums


def windings(sheet: Sheet, first: int, stop: int) -> NDArray[np.int64]:
    """(stop - first, columns of the sheet)  sums of the signs; one number all over on a surface that is closed"""
    window = _window(sheet, first, stop)
    spans, _ = _spans(sheet, sheet.in_band(first), window)
    steps = np.zeros((window.rows, window.cols + 1), np.int64)
    for ends, way in ((spans.left, 1), (spans.right, -1)):
        np.add.at(steps, (spans.row - window.row, ends - window.col), way * spans.sign)
    return np.cumsum(steps, axis=1)[:, :-1]


def counts(sheet: Sheet, first: int, stop: int) -> Ints:
    """(stop - first, columns of the sheet)  how often each ray crosses a surface; rows as in `chords`"""
    return _spans(sheet, sheet.in_band(first), _window(sheet, first, stop))[1]


def crossings(sheet: Sheet, first: int, stop: int) -> Crossings:
    """Every crossing of the rows' rays with a surface, in order along each ray; rows as in `chords`"""
    window = _window(sheet, first, stop)
    spans, number = _spans(sheet, sheet.in_band(first), window)
    listed = room_for(window, number)
    _fill(spans, sheet, listed, listed.starts[:-1].copy())
    return listed


def refill(sheet: Sheet, listed: Crossings, pixels: NDArray[np.bool_]) -> None:
    """Compute the crossings of some pixels anew, in place.

    listed  crossings of a window inside one band, of which the numbers are right
    pixels  (rows x cols,)  which of its pixels
    """
    spans, _ = _spans(sheet, sheet.in_band(listed.window.row), listed.window)
    _fill(spans, sheet, listed, np.where(pixels, listed.starts[:-1], -1))


def _window(sheet: Sheet, first: int, stop: int) -> Window:
    return Window(first, sheet.cols[0], stop - first, sheet.cols[1] - sheet.cols[0])


def _spans(sheet: Sheet, picked: Ints, window: Window) -> tuple[_Spans, Ints]:
    """Where the picked triangles cover pixels of a window, and how many cover each of its pixels (rows, cols)."""
    top, bottom = sheet.triangles.rows[picked].T
    heights = np.minimum(bottom, window.row + window.rows) - np.maximum(top, window.row)
    most = int(np.maximum(heights, 0).sum())
    spans = _Spans(*(np.empty(most, np.int32) for _ in _Spans._fields))
    number = np.zeros((window.rows, window.cols), np.int32)
    count = _find_spans(picked, sheet.triangles, window, spans, number)
    return _Spans(*(part[:count] for part in spans)), np.cumsum(number, axis=1, dtype=np.int32, out=number)


def _fill(spans: _Spans, sheet: Sheet, listed: Crossings, free: NDArray[np.int64]) -> None:
    _list(spans, sheet.triangles, sheet.frame, listed, free)
    order(listed.starts, listed.depth, listed.sign)


@callee()
def _crossing(projected: Array, one: int, other: int, row: int) -> float:
    """Column at which an edge crosses a row; the same bits whichever way the edge is run along."""
    i, j = min(one, other), max(one, other)
    start, end = projected[i, 1], projected[j, 1]
    column = start + (row - projected[i, 0]) / (projected[j, 0] - projected[i, 0]) * (end - start)
    # Rounding must not carry it off the edge: triangles are left out of a band by the columns of their vertices.
    return min(max(column, min(start, end)), max(start, end))


@kernel()
def _find_spans(picked: Ints, triangles: Triangles, window: Window, spans: _Spans, steps: Ints) -> int:
    """Fill in the spans; returns their count. To `steps` (rows, cols) one is added where a span begins on a row,
    and one taken where it has ended."""
    count, projected = 0, triangles.projected
    for k in picked:
        for row in range(max(triangles.rows[k, 0], window.row), min(triangles.rows[k, 1], window.row + window.rows)):
            down, up = 0.0, 0.0
            for corner in range(3):
                one, other = triangles.faces[k, corner], triangles.faces[k, (corner + 1) % 3]
                # Half-open, so that a vertex on a pixel row belongs to one of its two edges.
                above, below = projected[one, 0] <= row, projected[other, 0] <= row
                if above != below:
                    column = _crossing(projected, one, other, row)
                    down, up = (column, up) if above else (down, column)
            left = max(math.ceil(min(down, up)), window.col)
            right = min(math.ceil(max(down, up)), window.col + window.cols)
            if left < right:
                spans.triangle[count], spans.row[count], spans.left[count], spans.right[count] = k, row, left, right
                spans.sign[count] = 1 if up < down else -1  # outward triangles that are seen from behind
                steps[row - window.row, left - window.col] += 1
                if right < window.col + window.cols:
                    steps[row - window.row, right - window.col] -= 1
                count += 1
    return count


@kernel()
def _scan(spans: _Spans, triangles: Triangles, frame: Frame, window: Window, sums: Array) -> None:
    """Add sign x depth at the pixels of the spans to `sums` (rows, cols)."""
    for n in range(len(spans.row)):
        k, row = spans.triangle[n], spans.row[n]
        # A triangle seen edge-on has no depth of its own at a pixel; between those of its vertices it stays in bounds.
        # A crossing behind the detector counts as one in its plane.
        near, far = min(triangles.near[k], 1.0), min(triangles.far[k], 1.0)
        x, sign = triangles.planes[k, 0], float(spans.sign[n])
        start = x * frame.way.x + triangles.planes[k, 1] * frame.way.y
        start += triangles.planes[k, 2] * (frame.way.z - row * frame.pixel_mm)
        for col in range(spans.left[n], spans.right[n]):
            at = triangles.planes[k, 3] / (start + x * (col * frame.pixel_mm))
            at = at if at > near else near  # this way round, so that 0/0 gives a bound too
            at = at if at < far else far
            sums[row - window.row, col - window.col] += sign * at


@kernel()
def _list(spans: _Spans, triangles: Triangles, frame: Frame, listed: Crossings, free: NDArray[np.int64]) -> None:
    """Write the crossings at pixels of the spans to where `free` says, and move it on; if below 0, not."""
    for n in range(len(spans.row)):
        k, row = spans.triangle[n], spans.row[n]
        near, far = triangles.near[k], triangles.far[k]
        x = triangles.planes[k, 0]
        start = x * frame.way.x + triangles.planes[k, 1] * frame.way.y
        start += triangles.planes[k, 2] * (frame.way.z - row * frame.pixel_mm)
        for col in range(spans.left[n], spans.right[n]):
            pixel = (row - listed.window.row) * listed.window.cols + col - listed.window.col
            place = free[pixel]
            if place >= 0:
                at = triangles.planes[k, 3] / (start + x * (col * frame.pixel_mm))
                at = at if at > near else near
                listed.depth[place], listed.sign[place] = at if at < far else far, spans.sign[n]
                free[pixel] = place + 1
