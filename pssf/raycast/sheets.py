"""Surfaces as a detector sees them: projected, with the plane of every triangle, sorted into bands of rows."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.repair import Solid
from ..geometry.view import View, depth_of, seen_at
from .clip import NEAREST, clip

# Rows of one band. An image is worked on band by band, however many workers there are: the bytes do not depend on it.
BAND_ROWS = 32


class Point(NamedTuple):
    """A place or a way in the knee frame, mm."""

    x: float
    y: float
    z: float


class Frame(NamedTuple):
    """Where rays begin and end: the source, the way from it to the centre of pixel (0, 0), the pixel's size, mm."""

    source: Point
    way: Point
    pixel_mm: float


class Triangles(NamedTuple):
    """Triangles as compiled code takes them. A depth is a fraction of the way from the source to the pixel.

    faces      (m, 3)  int32 vertex indices, outward
    projected  (n, 2)  row and column at which a vertex is seen
    planes     (m, 4)  normal, not of length 1, and its product with (vertex - source); the depth at a pixel is the
                       fourth over the product of the normal with (pixel - source)
    near, far  (m,)    depths of the nearest and of the farthest vertex
    rows       (m, 2)  int32 half-open ranges of the rows that they may cover
    """

    faces: NDArray[np.int32]
    projected: Array
    planes: Array
    near: Array
    far: Array
    rows: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One closed surface, projected.

    What is behind the source is cut off. The surface is then open, at the source, and the signs of the crossings of
    every ray add up to how often it goes around the source instead of to zero.

    frame       of the detector that sees it
    points      (n, 3)   vertices, mm
    triangles   of which it is made
    rows, cols  half-open ranges of the pixels that the surface can cover
    order       (k,) int32 triangles of band 0, then band 1, and so on; those that cover no pixel are left out
    starts      (bands + 1,) where the bands start in `order`
    cut         whether part of it is behind the source
    """

    frame: Frame
    points: Array
    triangles: Triangles
    rows: tuple[int, int]
    cols: tuple[int, int]
    order: NDArray[np.int32]
    starts: NDArray[np.int64]
    cut: bool

    def in_band(self, row: int) -> NDArray[np.int32]:
        """Triangles that may cover pixels of the band in which a row lies."""
        band = row // BAND_ROWS
        return self.order[self.starts[band] : self.starts[band + 1]]


def frame_of(view: View) -> Frame:
    """Where the rays of a view begin and end."""
    (x, y, z), source = view.corner_mm, Point(*map(float, view.source_mm))
    return Frame(source, Point(float(x - source.x), float(y - source.y), float(z - source.z)), float(view.pixel_mm))


def sheet_of(solid: Solid, view: View) -> Sheet:
    """A solid as seen in a view."""
    points, faces, depth, frame = solid.points, solid.faces, depth_of(solid.points, view), frame_of(view)
    planes = _planes(points, faces, frame.source)
    cut = bool(depth.min() < NEAREST)
    if cut:
        points, faces, depth, origin = clip(points, faces, depth)
        planes = planes[origin]
    projected = seen_at(points, depth, view)
    low, high = np.zeros(2, int), np.zeros(2, int)
    for axis, size in enumerate((view.rows, view.cols) if len(faces) else ()):
        low[axis] = np.clip(np.ceil(projected[:, axis].min()), 0, size)
        high[axis] = np.clip(np.floor(projected[:, axis].max()) + 1, low[axis], size)
    rows, order, starts = _in_bands(projected, faces, view)
    near, far = _extremes(depth, faces)
    return Sheet(
        frame=frame,
        points=points,
        triangles=Triangles(faces, projected, planes, near, far, rows),
        rows=(int(low[0]), int(high[0])),
        cols=(int(low[1]), int(high[1])),
        order=order,
        starts=starts,
        cut=cut,
    )


def _extremes(values: Array, faces: NDArray[np.int32]) -> tuple[Array, Array]:
    """(m,), (m,)  least and largest of the values (n,) of each face's vertices"""
    a, b, c = (values[faces[:, corner]] for corner in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _planes(points: Array, faces: NDArray[np.int32], source: Point) -> Array:
    """(m, 4)  normal and its product with (vertex - source)"""
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scaled = x * (a[:, 0] - source.x) + y * (a[:, 1] - source.y) + z * (a[:, 2] - source.z)
    return np.column_stack((x, y, z, scaled))


def _in_bands(
    projected: Array, faces: NDArray[np.int32], view: View
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Ranges of rows (m, 2) as in Triangles; `order` and `starts` as in Sheet."""
    # An edge that runs along a row of pixels belongs to what lies before it: ranges are half-open at both ends.
    (top, bottom), (left, right) = (
        np.clip(np.ceil(_extremes(projected[:, axis], faces)), 0, size).astype(np.int32)
        for axis, size in enumerate((view.rows, view.cols))
    )
    bands = -(-view.rows // BAND_ROWS)
    first, last = top // BAND_ROWS, (bottom - 1) // BAND_ROWS
    number = np.where((top < bottom) & (left < right), last - first + 1, 0)
    triangle = np.repeat(np.arange(len(faces), dtype=np.int32), number)
    band = np.arange(len(triangle)) - np.repeat(np.cumsum(number) - number - first, number)
    starts = np.zeros(bands + 1, np.int64)
    np.cumsum(np.bincount(band, minlength=bands), out=starts[1:])
    return np.column_stack((top, bottom)), triangle[np.argsort(band, kind="stable")], starts
