"""Surfaces as a detector sees them: projected, with the plane of every triangle, sorted into bands of rows."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..checks import Array, InputError
from ..geometry import View, project
from ..scene import Surface

# Rows of one band. An image is worked on band by band, however many workers there are: the bytes do not depend on it.
BAND_ROWS = 32

# Nearer to the plane of the focus than this, projections grow out of bounds.
CLEARANCE_MM = 1.0


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One closed surface, projected. A depth is a fraction of the way from the source to the pixel.

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

    def in_band(self, row: int) -> NDArray[np.int32]:
        """Triangles that may cover pixels of the band in which a row lies."""
        band = row // BAND_ROWS
        return self.order[self.starts[band] : self.starts[band + 1]]


def frame_of(view: View) -> Array:
    """(7,)  source x, y, z; source to pixel (0, 0) x, y, z; pixel size (mm)"""
    source = np.asarray(view.source_mm)
    return np.concatenate((source, np.asarray(view.corner_mm) - source, [view.pixel_mm]))


def sheet_of(surface: Surface, view: View) -> Sheet:
    """A surface as seen in a view.

    raises  InputError naming the surface if it is not between source and detector
    """
    points = np.ascontiguousarray(surface.mesh.vertices, dtype=np.float64)
    faces = np.ascontiguousarray(surface.mesh.faces, dtype=np.int32)
    _require_between(points, view, surface.name)
    seen = project(points, view)
    depth = (points[:, 1] - view.source_mm[1]) / (view.centre_mm[1] - view.source_mm[1])
    low = np.clip(np.ceil(seen.min(axis=0)), 0, (view.rows, view.cols)).astype(int)
    high = np.clip(np.floor(seen.max(axis=0)) + 1, low, (view.rows, view.cols)).astype(int)
    bands = -(-view.rows // BAND_ROWS)
    order, starts = _bin(seen, faces, view.rows, view.cols, bands)
    frame = frame_of(view)
    return Sheet(
        frame=frame,
        points=points,
        seen=seen,
        depth=depth,
        faces=faces,
        planes=_planes(points, faces, frame),
        rows=(int(low[0]), int(high[0])),
        cols=(int(low[1]), int(high[1])),
        order=order,
        starts=starts,
    )


def _require_between(points: Array, view: View, name: str) -> None:
    low, high = view.source_mm[1] + CLEARANCE_MM, view.centre_mm[1]
    near, far = float(points[:, 1].min()), float(points[:, 1].max())
    if near < low or far > high:
        raise InputError(
            f"{name}: reaches from y = {near:.6g} to {far:.6g} mm; allowed: between source and detector, "
            f"{low:.6g} to {high:.6g} mm"
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
