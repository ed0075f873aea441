"""Triangles cut off in front of the source: what is behind it, no ray meets."""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array

# Fraction of the way from the source to the detector. Nearer than this, crossings are not told from the source itself;
# projections grow to 1e7 times the detector's distance at most, where float64 still resolves 1e-5 pixels.
NEAREST = 1e-7


def clip(
    points: Array, faces: NDArray[np.int32], depth: Array
) -> tuple[Array, NDArray[np.int32], Array, NDArray[np.int64]]:
    """The part of a mesh that is at least NEAREST deep.

    points   (n, 3)  mm
    faces    (m, 3)  vertex numbers
    depth    (n,)    share of the way from the source to the detector
    returns  points, faces and depths of what is left, and for every face of it the one it was cut from
    """
    ahead = depth >= NEAREST
    count = ahead[faces].sum(axis=1)
    whole = np.flatnonzero(count == 3)
    # A face is turned so that its odd corner, the only one ahead or the only one behind, comes first.
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    odd_one, odd_two = _odd_first(faces[one], ahead[faces[one]]), _odd_first(faces[two], ~ahead[faces[two]])
    cut = np.concatenate((odd_one[:, [0, 1]], odd_one[:, [2, 0]], odd_two[:, [0, 1]], odd_two[:, [2, 0]]))
    # Both faces of an edge get the same vertex, so that the cut mesh is as tight as the whole one.
    edges, number = np.unique(np.sort(cut, axis=1), axis=0, return_inverse=True)
    along = (NEAREST - depth[edges[:, 0]]) / (depth[edges[:, 1]] - depth[edges[:, 0]])
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
        np.concatenate((depth, np.full(len(cuts), NEAREST)))[kept],
        np.concatenate((whole, one, two, two)),
    )


def _odd_first(faces: NDArray[np.int32], odd: NDArray[np.bool_]) -> NDArray[np.int32]:
    turn = (odd.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1)
