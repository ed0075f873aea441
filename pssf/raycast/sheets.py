"""Surfaces as a detector sees them: projected, with the plane of every triangle, sorted into bands of rows."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.repair import Solid
from ..geometry.view import View, depth_of, seen_at
from .clip import NEAREST, clip

# Rows of one band. An image is worked on band by band, however many workers there are: the bytes do not depend on it.
BAND_ROWS = 32


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One closed surface, projected. A depth is a fraction of the way from the source to the pixel.

    What is behind the source is cut off. The surface is then open, at the source, and the signs of the crossings of
    every ray add up to how often it goes around the source instead of to zero.

    frame   (7,)     source x, y, z; source to pixel (0, 0) x, y, z; pixel size (mm)
    points  (n, 3)   vertices, mm
    seen    (n, 2)   row and column at which a vertex is seen
    depth   (n,)     depth of a vertex
    faces   (m, 3)   int32 vertex indices, outward
    planes  (m, 4)   normal, not of length 1, and its product with (vertex - source); the depth at a pixel is the
                     fourth over the product of the normal with (pixel - source)
    rows, cols       half-open ranges of the pixels that the surface can cover
    order            (k,) int32 triangles of band 0, then band 1, and so on; those that cover no pixel are left out
    starts           (bands + 1,) where the bands start in `order`
    cut              whether part of it is behind the source
    """

    frame: Array
    points: Array
    seen: Array
    depth: Array
    faces: NDArray[np.int32]
    planes: Array
    rows: tuple[int, int]
    cols: tuple[int, int]
    order: NDArray[np.int32]
    starts: NDArray[np.int64]
    cut: bool

    def in_band(self, row: int) -> NDArray[np.int32]:
        """Triangles that may cover pixels of the band in which a row lies."""
        band = row // BAND_ROWS
        return self.order[self.starts[band] : self.starts[band + 1]]


def frame_of(view: View) -> Array:
    """(7,)  source x, y, z; source to pixel (0, 0) x, y, z; pixel size (mm)"""
    source = np.asarray(view.source_mm)
    return np.concatenate((source, np.asarray(view.corner_mm) - source, [view.pixel_mm]))


def sheet_of(solid: Solid, view: View) -> Sheet:
    """A solid as seen in a view."""
    points, faces, depth, frame = solid.points, solid.faces, depth_of(solid.points, view), frame_of(view)
    planes = _planes(points, faces, frame)
    cut = bool(depth.min() < NEAREST)
    if cut:
        points, faces, depth, origin = clip(points, faces, depth)
        planes = planes[origin]
    seen = seen_at(points, depth, view)
    low, high = np.zeros(2, int), np.zeros(2, int)
    for axis, size in enumerate((view.rows, view.cols) if len(faces) else ()):
        low[axis] = np.clip(np.ceil(seen[:, axis].min()), 0, size)
        high[axis] = np.clip(np.floor(seen[:, axis].max()) + 1, low[axis], size)
    bands = -(-view.rows // BAND_ROWS)
    order, starts = _bin(seen, faces, view.rows, view.cols, bands)
    return Sheet(
        frame=frame,
        points=points,
        seen=seen,
        depth=depth,
        faces=faces,
        planes=planes,
        rows=(int(low[0]), int(high[0])),
        cols=(int(low[1]), int(high[1])),
        order=order,
        starts=starts,
        cut=cut,
    )


@njit(cache=True, nogil=True)
def _planes(points: Array, faces: NDArray[np.int32], frame: Array) -> Array:
    """(m, 4)  normal and its product with (vertex - source)"""
    planes = np.empty((len(faces), 4))
    for k in range(len(faces)):
        a, b, c = points[faces[k, 0]], points[faces[k, 1]], points[faces[k, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        planes[k, 0], planes[k, 1], planes[k, 2] = x, y, z
        planes[k, 3] = x * (a[0] - frame[0]) + y * (a[1] - frame[1]) + z * (a[2] - frame[2])
    return planes


@njit(cache=True, nogil=True)
def _bin(
    seen: Array, faces: NDArray[np.int32], rows: int, cols: int, bands: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Triangles by band; `order` and `starts` as in Sheet."""
    starts = np.zeros(bands + 1, np.int64)
    first = np.empty(len(faces), np.int32)
    last = np.empty(len(faces), np.int32)
    for k in range(len(faces)):
        a, b, c = seen[faces[k, 0]], seen[faces[k, 1]], seen[faces[k, 2]]
        top = max(math.ceil(min(a[0], b[0], c[0])), 0)
        bottom = min(math.ceil(max(a[0], b[0], c[0])), rows) - 1
        left = max(math.ceil(min(a[1], b[1], c[1])), 0)
        right = min(math.ceil(max(a[1], b[1], c[1])), cols) - 1
        first[k], last[k] = 0, -1
        if top <= bottom and left <= right:
            first[k], last[k] = top // BAND_ROWS, bottom // BAND_ROWS
        for band in range(first[k], last[k] + 1):
            starts[band + 1] += 1
    starts = np.cumsum(starts)
    order = np.empty(starts[-1], np.int32)
    free = starts.copy()
    for k in range(len(faces)):
        for band in range(first[k], last[k] + 1):
            order[free[band]] = k
            free[band] += 1
    return order, starts
