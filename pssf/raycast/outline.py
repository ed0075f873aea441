"""Pixels so near the outline of a surface that float32 may miss the surface there, entry and exit both.

Away from the folds of the projection, where triangles seen from the front meet triangles seen from behind, a small
sideways error takes a ray to a neighbouring triangle at most, and that shows. At a fold two crossings vanish together
and the signs still add up to zero. So these pixels are found by geometry, in float64.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..checks import Array
from .sheets import Sheet

# A triangle whose plane misses the source by less than this (sine of the angle) is on both sides: rounding decides.
EDGE_ON = 1e-10


def outline(sheet: Sheet, slack_mm: float) -> NDArray[np.int64]:
    """Pixels whose ray passes a fold of the projection within a distance.

    slack_mm  sideways, at the surface
    returns   (k, 2)  row and column, in order of rows; a pixel may stand more than once
    """
    slack_px = slack_mm / (sheet.frame[6] * float(sheet.depth.min()))
    folds = _folds(sheet.points, sheet.faces, sheet.planes, sheet.frame)
    count = _pixels_near(folds, sheet.seen, slack_px, sheet.rows, sheet.cols, np.empty((0, 2), np.int64))
    pixels = np.empty((count, 2), np.int64)
    _pixels_near(folds, sheet.seen, slack_px, sheet.rows, sheet.cols, pixels)
    return pixels[np.argsort(pixels[:, 0], kind="stable")]


@njit(cache=True, nogil=True)
def _folds(points: Array, faces: NDArray[np.int32], planes: Array, frame: Array) -> NDArray[np.int32]:
    """(k, 2)  edges between two vertices that each belong to triangles seen from the front and from behind.

    All folds are among them; the few others lie beside a fold.
    """
    front, behind = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    for k in range(len(faces)):
        x, y, z, scaled = planes[k]
        away = points[faces[k, 0]] - frame[:3]
        unsure = EDGE_ON * math.sqrt((x * x + y * y + z * z) * (away * away).sum())
        for vertex in faces[k]:
            front[vertex] |= scaled <= unsure
            behind[vertex] |= scaled >= -unsure
    both = front & behind
    edges = np.empty((3 * len(faces), 2), np.int32)
    count = 0
    for face in faces:
        for corner in range(3):
            one, other = face[corner], face[(corner + 1) % 3]
            if one < other and both[one] and both[other]:  # the triangle beyond has it the other way round
                edges[count, 0], edges[count, 1] = one, other
                count += 1
    return edges[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _pixels_near(
    edges: NDArray[np.int32],
    seen: Array,
    slack: float,
    rows: tuple[int, int],
    cols: tuple[int, int],
    pixels: NDArray[np.int64],
) -> int:
    """Write the pixels within `slack` of an edge (in row and column) as far as there is room; returns their count."""
    count = 0
    for one, other in edges:
        start, way = seen[one], seen[other] - seen[one]
        top = max(math.ceil(min(start[0], start[0] + way[0]) - slack), rows[0])
        bottom = min(math.floor(max(start[0], start[0] + way[0]) + slack) + 1, rows[1])
        for row in range(top, bottom):
            enter, leave = 0.0, 1.0
            if way[0] != 0.0:
                near, far = (row - slack - start[0]) / way[0], (row + slack - start[0]) / way[0]
                enter, leave = min(max(min(near, far), 0.0), 1.0), min(max(max(near, far), 0.0), 1.0)
            left, right = start[1] + enter * way[1], start[1] + leave * way[1]
            first = max(math.ceil(min(left, right) - slack), cols[0])
            for col in range(first, min(math.floor(max(left, right) + slack) + 1, cols[1])):
                if count < len(pixels):
                    pixels[count, 0], pixels[count, 1] = row, col
                count += 1
    return count
