"""Scanline engine: project triangles onto the detector and sum their signed depths per pixel, in float64.

The projected triangles have neither gaps nor overlaps. On a pixel row, a triangle covers the columns between two of its
directed edges, one downward and one upward. Two adjacent triangles share an edge in opposite directions, and the column
of the edge is identical to the last bit for both. The crossing signs of a closed surface therefore add up to zero at
every pixel, even for very thin triangles and triangles seen edge-on.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.numba_kernel import kernel, kernel_helper
from ..path_lengths import Audit
from .crossings import (
    Crossings,
    Window,
    allocate_crossings,
    sort_crossings,
)
from .projected_surface import ProjectedSurface, RayFrame, Triangles

Ints = NDArray[np.int32]


class Caster:
    """Ray caster for one surface, with the interface of the Embree caster.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    around : int
        Winding number of the surface around the source; the scanline engine does not need it.
    """

    def __init__(self, sheet: ProjectedSurface, around: int) -> None:
        del around  # The crossing signs need no check, because the scanline method is exact.
        self.sheet = sheet

    def trace_chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """Compute the chords inside the surface for the rays to a range of rows.

        Parameters
        ----------
        first, stop : int
            Half-open range of rows within one band of `BAND_ROWS` rows.

        Returns
        -------
        chords : (rows, cols) float64 array
            Lengths inside the surface, as fractions of the source-to-pixel distance.
        audit : Audit
            Number of rays; no ray needs to be recomputed.
        """
        lengths = trace_chords(self.sheet, first, stop)
        return lengths, Audit(rays=lengths.size)

    def find_crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """Find the crossings of rays with the surface, for a range of rows.

        Parameters
        ----------
        first, stop : int
            Half-open range of rows within one band of `BAND_ROWS` rows.

        Returns
        -------
        crossings : Crossings
            Crossings of all rays, in order along each ray.
        audit : Audit
            Number of rays; no ray needs to be recomputed.
        """
        listed = find_crossings(self.sheet, first, stop)
        return listed, Audit(rays=len(listed.starts) - 1)


class _Spans(NamedTuple):
    """Pixel runs, each in one row and within one triangle; all arrays have shape (n,).

    `triangle` is the number of the triangle, `row` the image row, and `left` to `right` the half-open range of columns.
    `sign` is +1 where rays leave the surface through the triangle, and -1 where they enter.
    """

    triangle: Ints
    row: Ints
    left: Ints
    right: Ints
    sign: Ints


def trace_chords(sheet: ProjectedSurface, first: int, stop: int) -> Array:
    """Compute the chords inside a surface for a range of rows.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    first, stop : int
        Half-open range of rows within one band of `BAND_ROWS` rows.

    Returns
    -------
    (rows, cols) float64 array
        Sum of sign x depth over the crossings, + on exit and - on entry, for the columns of `sheet`. Depths are
        fractions of the source-to-pixel distance.
    """
    window = _make_window(sheet, first, stop)
    sums = np.zeros((window.rows, window.cols))
    _accumulate_depths(
        _collect_spans(sheet, sheet.triangles_in_band(first), window)[0], sheet.triangles, sheet.frame, window, sums
    )
    return sums


def sum_windings(sheet: ProjectedSurface, first: int, stop: int) -> NDArray[np.int64]:
    """Sum the crossing signs of each ray.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    first, stop : int
        Half-open range of rows within one band of `BAND_ROWS` rows.

    Returns
    -------
    (rows, cols) int64 array
        Sums of crossing signs for the columns of `sheet`. For a closed surface, all sums are equal.
    """
    window = _make_window(sheet, first, stop)
    spans, _ = _collect_spans(sheet, sheet.triangles_in_band(first), window)
    steps = np.zeros((window.rows, window.cols + 1), np.int64)
    for ends, way in ((spans.left, 1), (spans.right, -1)):
        np.add.at(steps, (spans.row - window.row, ends - window.col), way * spans.sign)
    return np.cumsum(steps, axis=1)[:, :-1]


def count_crossings(sheet: ProjectedSurface, first: int, stop: int) -> Ints:
    """Count the crossings of each ray with a surface.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    first, stop : int
        Half-open range of rows within one band of `BAND_ROWS` rows.

    Returns
    -------
    (rows, cols) int32 array
        Number of crossings of each ray, for the columns of `sheet`.
    """
    return _collect_spans(sheet, sheet.triangles_in_band(first), _make_window(sheet, first, stop))[1]


def find_crossings(sheet: ProjectedSurface, first: int, stop: int) -> Crossings:
    """Find every crossing of a surface with the rays to a range of rows.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    first, stop : int
        Half-open range of rows within one band of `BAND_ROWS` rows.

    Returns
    -------
    Crossings
        Crossings for the columns of `sheet`, in order along each ray.
    """
    window = _make_window(sheet, first, stop)
    spans, number = _collect_spans(sheet, sheet.triangles_in_band(first), window)
    listed = allocate_crossings(window, number)
    _fill_crossings(spans, sheet, listed, listed.starts[:-1].copy())
    return listed


def recompute_crossings(sheet: ProjectedSurface, window_crossings: Crossings, pixels: NDArray[np.bool_]) -> None:
    """Recompute the crossings of selected pixels, in place.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    window_crossings : Crossings
        Crossings of a window within one band. The number of crossings per pixel must be correct.
    pixels : (rows x cols,) bool array
        True for the pixels to recompute.
    """
    spans, _ = _collect_spans(sheet, sheet.triangles_in_band(window_crossings.window.row), window_crossings.window)
    _fill_crossings(spans, sheet, window_crossings, np.where(pixels, window_crossings.starts[:-1], -1))


def _make_window(sheet: ProjectedSurface, first: int, stop: int) -> Window:
    """Make a window from a range of rows and the columns that a surface can cover."""
    return Window(first, sheet.cols[0], stop - first, sheet.cols[1] - sheet.cols[0])


def _collect_spans(sheet: ProjectedSurface, picked: Ints, window: Window) -> tuple[_Spans, Ints]:
    """Find the spans of the selected triangles in a window, and count the crossings of each pixel (rows, cols)."""
    top, bottom = sheet.triangles.rows[picked].T
    heights = np.minimum(bottom, window.row + window.rows) - np.maximum(top, window.row)
    most = int(np.maximum(heights, 0).sum())
    spans = _Spans(*(np.empty(most, np.int32) for _ in _Spans._fields))
    number = np.zeros((window.rows, window.cols), np.int32)
    count = _find_spans(picked, sheet.triangles, window, spans, number)
    return _Spans(*(part[:count] for part in spans)), np.cumsum(number, axis=1, dtype=np.int32, out=number)


def _fill_crossings(
    spans: _Spans, sheet: ProjectedSurface, window_crossings: Crossings, next_slot: NDArray[np.int64]
) -> None:
    """Write the crossings of the spans, and sort the crossings by depth."""
    _write_crossings(spans, sheet.triangles, sheet.frame, window_crossings, next_slot)
    sort_crossings(window_crossings.starts, window_crossings.depth, window_crossings.sign)


@kernel_helper()
def _edge_column(projected: Array, one: int, other: int, row: int) -> float:
    """Compute the column at which an edge crosses a row, identical to the last bit for both edge directions."""
    i, j = min(one, other), max(one, other)
    start, end = projected[i, 1], projected[j, 1]
    column = start + (row - projected[i, 0]) / (projected[j, 0] - projected[i, 0]) * (end - start)
    # The column is clipped to the edge, because a rounding error could move it outside the pixel range of the triangle.
    return min(max(column, min(start, end)), max(start, end))


@kernel()
def _find_spans(picked: Ints, triangles: Triangles, window: Window, spans: _Spans, steps: Ints) -> int:
    """Fill the arrays of `spans` and return the number of spans.

    In `steps` (rows, cols), each span adds 1 at its first column and subtracts 1 after its last column.
    """
    count, projected = 0, triangles.projected
    for k in picked:
        for row in range(max(triangles.rows[k, 0], window.row), min(triangles.rows[k, 1], window.row + window.rows)):
            down, up = 0.0, 0.0
            for corner in range(3):
                one, other = triangles.faces[k, corner], triangles.faces[k, (corner + 1) % 3]
                # The row range of an edge is half-open, so that a vertex on a pixel row belongs to only one of the two
                # edges at the vertex.
                above, below = projected[one, 0] <= row, projected[other, 0] <= row
                if above != below:
                    column = _edge_column(projected, one, other, row)
                    down, up = (column, up) if above else (down, column)
            left = max(math.ceil(min(down, up)), window.col)
            right = min(math.ceil(max(down, up)), window.col + window.cols)
            if left < right:
                spans.triangle[count], spans.row[count], spans.left[count], spans.right[count] = k, row, left, right
                spans.sign[count] = 1 if up < down else -1  # The sign is +1 if the ray meets the triangle from behind.
                steps[row - window.row, left - window.col] += 1
                if right < window.col + window.cols:
                    steps[row - window.row, right - window.col] -= 1
                count += 1
    return count


@kernel()
def _accumulate_depths(spans: _Spans, triangles: Triangles, frame: RayFrame, window: Window, sums: Array) -> None:
    """Add sign x depth to `sums` (rows, cols), for all pixels of the spans."""
    for n in range(len(spans.row)):
        k, row = spans.triangle[n], spans.row[n]
        # The depth of a triangle seen edge-on is undefined, so depths are clipped to the depth range of the vertices.
        # The depth of a crossing behind the detector is set to the depth of the detector plane.
        near, far = min(triangles.near[k], 1.0), min(triangles.far[k], 1.0)
        x, sign = triangles.planes[k, 0], float(spans.sign[n])
        start = x * frame.corner_vector.x + triangles.planes[k, 1] * frame.corner_vector.y
        start += triangles.planes[k, 2] * (frame.corner_vector.z - row * frame.pixel_mm)
        for col in range(spans.left[n], spans.right[n]):
            at = triangles.planes[k, 3] / (start + x * (col * frame.pixel_mm))
            at = at if at > near else near  # This comparison replaces NaN (from 0/0) by `near`.
            at = at if at < far else far
            sums[row - window.row, col - window.col] += sign * at


@kernel()
def _write_crossings(
    spans: _Spans, triangles: Triangles, frame: RayFrame, window_crossings: Crossings, next_slot: NDArray[np.int64]
) -> None:
    """Store the crossing of the surface and the ray for every pixel of the spans.

    `next_slot` (pixels,) is the next free index of each pixel; it is advanced in place. Pixels with a negative index
    are skipped.
    """
    for n in range(len(spans.row)):
        k, row = spans.triangle[n], spans.row[n]
        near, far = triangles.near[k], triangles.far[k]
        x = triangles.planes[k, 0]
        start = x * frame.corner_vector.x + triangles.planes[k, 1] * frame.corner_vector.y
        start += triangles.planes[k, 2] * (frame.corner_vector.z - row * frame.pixel_mm)
        for col in range(spans.left[n], spans.right[n]):
            pixel = (
                (row - window_crossings.window.row) * window_crossings.window.cols + col - window_crossings.window.col
            )
            place = next_slot[pixel]
            if place >= 0:
                at = triangles.planes[k, 3] / (start + x * (col * frame.pixel_mm))
                at = at if at > near else near
                window_crossings.depth[place], window_crossings.sign[place] = at if at < far else far, spans.sign[n]
                next_slot[pixel] = place + 1
