"""Clip triangles at the source, because rays do not reach surface parts behind the source."""

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array

# Smallest depth of a clipped mesh, as a fraction of the source-to-detector distance. Projected coordinates are then at
# most 1e7 times the source-to-detector distance, where float64 still resolves 1e-5 pixels.
MIN_DEPTH_FRACTION = 1e-7


def clip_mesh_at_source(
    points: Array, faces: NDArray[np.int32], depth: Array
) -> tuple[Array, NDArray[np.int32], Array, NDArray[np.int64]]:
    """Cut off the part of a mesh with a depth below `MIN_DEPTH_FRACTION`.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Vertices.
    faces : (m, 3) int32 array
        Vertex numbers of the faces.
    depth : (n,) float64 array, dimensionless
        Depth of each vertex, as a fraction of the source-to-detector distance.

    Returns
    -------
    points : (p, 3) float64 array
        Remaining vertices and new vertices on the cut, in mm.
    faces : (q, 3) int32 array
        Vertex numbers of the remaining faces.
    depth : (p,) float64 array
        Depths of the returned vertices.
    origin : (q,) int64 array
        Number of the original face of each returned face.
    """
    ahead = depth >= MIN_DEPTH_FRACTION
    count = ahead[faces].sum(axis=1)
    whole = np.flatnonzero(count == 3)
    # The corners of a cut face are rotated, so that the single corner on one side of the cutting plane comes first.
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    odd_one, odd_two = (
        _rotate_odd_corner_first(faces[one], ahead[faces[one]]),
        _rotate_odd_corner_first(faces[two], ~ahead[faces[two]]),
    )
    cut = np.concatenate((odd_one[:, [0, 1]], odd_one[:, [2, 0]], odd_two[:, [0, 1]], odd_two[:, [2, 0]]))
    # Two faces with a common cut edge share the new vertex on the edge, so that the cut leaves no gaps in the mesh.
    edges, number = np.unique(np.sort(cut, axis=1), axis=0, return_inverse=True)
    along = (MIN_DEPTH_FRACTION - depth[edges[:, 0]]) / (depth[edges[:, 1]] - depth[edges[:, 0]])
    cuts = points[edges[:, 0]] + along[:, None] * (points[edges[:, 1]] - points[edges[:, 0]])
    number = (number.ravel() + len(points)).astype(np.int32)
    a, b, c, d = np.split(number, np.cumsum([len(one), len(one), len(two)]))
    parts = (
        faces[whole],
        np.column_stack((odd_one[:, 0], a, b)),
        np.column_stack((c, odd_two[:, 1], odd_two[:, 2])),
        np.column_stack((c, odd_two[:, 2], d)),
    )
    kept = np.concatenate((ahead, np.ones(len(cuts), np.bool_)))
    renumber = (np.cumsum(kept) - 1).astype(np.int32)
    return (
        np.concatenate((points, cuts))[kept],
        np.ascontiguousarray(renumber[np.concatenate(parts)]),
        np.concatenate((depth, np.full(len(cuts), MIN_DEPTH_FRACTION)))[kept],
        np.concatenate((whole, one, two, two)),
    )


def _rotate_odd_corner_first(faces: NDArray[np.int32], odd: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Rotate the corners of faces (m, 3) so that the corner marked in `odd` (m, 3) is first."""
    turn = (odd.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1)
