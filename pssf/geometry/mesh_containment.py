"""Tests of whether a closed mesh contains another mesh, or two meshes are disjoint, without Boolean operations.

The faces are sorted into the cells of a grid. Two faces in the same cell intersect if they have no separating axis
(Gottschalk, Lin and Manocha 1996). If no faces intersect, each connected component of a mesh is entirely inside or
outside the other mesh. The solid angle of the other mesh, seen from one vertex of the component, distinguishes the two
cases (van Oosterom and Strackee 1983).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper
from .mesh import Mesh
from .mesh_topology import label_bodies

# Edge length of a grid cell, relative to the mean edge length of the face bounding boxes.
_SIDE = 2.5
# Maximum number of grid cells along an axis.
_MOST_CELLS = 128
# Distance below which two faces are classified as intersecting, in mm.
_CONTACT_DISTANCE_MM = 1e-9


class _Faces(NamedTuple):
    """Faces of a mesh with bounding boxes and planes, in mm.

    `corners` (n, 3, 3) are the corners of each face. `boxes` (n, 2, 3) are the bounding boxes of the faces. `planes`
    (n, 4) are the unit normals of the faces and the distances of the face planes from the origin.
    """

    corners: Array
    boxes: Array
    planes: Array


class _Grid(NamedTuple):
    """Faces of a mesh, sorted into the cells of a grid.

    The indices of the faces in cell k are ``order[starts[k]:starts[k + 1]]``. The cell index k varies fastest along x.
    """

    mesh: "_Faces"
    low: tuple[float, float, float]
    side_mm: float
    counts: tuple[int, int, int]
    starts: NDArray[np.int64]
    order: NDArray[np.int64]


def is_mesh_within(inner: Mesh, outer: Mesh) -> bool:
    """Report whether a closed mesh is entirely inside another closed mesh.

    Parameters
    ----------
    inner : Mesh
        Closed mesh with outward faces and one or more connected components, in mm.
    outer : Mesh
        Closed mesh with outward faces and one or more connected components, in mm.

    Returns
    -------
    bool
        True if `inner` is entirely inside `outer`, with more than 1e-9 mm between the faces of the two meshes.
    """
    one, other = (_prepare_faces(np.asarray(mesh.vertices, np.float64), mesh.faces) for mesh in (inner, outer))
    low, high = other.boxes[:, 0].min(axis=0), other.boxes[:, 1].max(axis=0)
    if (one.boxes[:, 0].min(axis=0) <= low).any() or (one.boxes[:, 1].max(axis=0) >= high).any():
        return False
    if _has_intersecting_faces(one, _build_grid(other)):
        return False
    return all(_winding_number(place, other.corners) > 0.5 for place in _pick_body_vertices(inner)) and all(
        _winding_number(place, one.corners) < 0.5 for place in _pick_body_vertices(outer)
    )


def are_meshes_disjoint(one: Mesh, other: Mesh) -> bool:
    """Report whether two closed meshes are disjoint.

    Parameters
    ----------
    one : Mesh
        Closed mesh with outward faces and one or more connected components, in mm.
    other : Mesh
        Closed mesh with outward faces and one or more connected components, in mm.

    Returns
    -------
    bool
        True if no component is inside the other mesh, and the faces of the two meshes are more than 1e-9 mm apart.
    """
    first, second = (_prepare_faces(np.asarray(mesh.vertices, np.float64), mesh.faces) for mesh in (one, other))
    if _has_intersecting_faces(first, _build_grid(second)):
        return False
    return all(_winding_number(place, second.corners) < 0.5 for place in _pick_body_vertices(one)) and all(
        _winding_number(place, first.corners) < 0.5 for place in _pick_body_vertices(other)
    )


def _build_grid(mesh: _Faces) -> _Grid:
    """Build a grid over the bounding box of a mesh and sort the faces into the grid cells."""
    low, high = mesh.boxes[:, 0].min(axis=0), mesh.boxes[:, 1].max(axis=0)
    extent_mm = float((mesh.boxes[:, 1] - mesh.boxes[:, 0]).mean())
    side_mm = max(_SIDE * extent_mm, float((high - low).max()) / _MOST_CELLS)
    x, y, z = (int(count) for count in np.floor((high - low) / side_mm) + 1)
    starts, no_order = np.zeros(x * y * z + 1, np.int64), np.empty(0, np.int64)
    grid = _Grid(mesh, tuple(low.tolist()), side_mm, (x, y, z), starts, no_order)
    _fill_grid(grid)
    grid = grid._replace(order=np.empty(grid.starts[-1], np.int64))
    _fill_grid(grid)
    return grid


def _pick_body_vertices(mesh: Mesh) -> Array:
    """Return one vertex of each connected component of a mesh, as a (components, 3) array in mm."""
    faces = np.ascontiguousarray(mesh.faces, np.int32)
    body, count = label_bodies(faces, len(mesh.vertices))
    first = np.full(count, -1)
    first[body[faces[::-1, 0]]] = faces[::-1, 0]
    return np.asarray(mesh.vertices[first[first >= 0]])


@kernel()
def _prepare_faces(vertices: Array, faces: NDArray[np.integer]) -> _Faces:
    """Compute corners, bounding boxes and planes of all faces."""
    corners, boxes, planes = np.empty((len(faces), 3, 3)), np.empty((len(faces), 2, 3)), np.empty((len(faces), 4))
    for k in range(len(faces)):
        for axis in range(3):
            one, two, three = (
                vertices[faces[k, 0], axis],
                vertices[faces[k, 1], axis],
                vertices[faces[k, 2], axis],
            )
            corners[k, 0, axis], corners[k, 1, axis], corners[k, 2, axis] = one, two, three
            boxes[k, 0, axis], boxes[k, 1, axis] = min(one, two, three), max(one, two, three)
        face = corners[k]
        ux, uy, uz = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1], face[1, 2] - face[0, 2]
        vx, vy, vz = face[2, 0] - face[0, 0], face[2, 1] - face[0, 1], face[2, 2] - face[0, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        # A face without area has no normal. Its normal is set to zero, because a zero vector never separates two faces.
        length = math.sqrt(x * x + y * y + z * z)
        share = 1.0 / length if length > 0.0 else 0.0
        x, y, z = x * share, y * share, z * share
        planes[k, 0], planes[k, 1], planes[k, 2] = x, y, z
        planes[k, 3] = x * face[0, 0] + y * face[0, 1] + z * face[0, 2]
    return _Faces(corners, boxes, planes)


@kernel_helper()
def _cell_range(low: float, high: float, origin: float, side: float, count: int) -> tuple[int, int]:
    """Return the indices of the first and the last of `count` cells along an axis that an interval in mm overlaps.

    If the interval overlaps no cell, the last index is less than the first index.
    """
    first, last = int((low - origin - _CONTACT_DISTANCE_MM) / side), int((high - origin + _CONTACT_DISTANCE_MM) / side)
    return max(first, 0), min(last, count - 1)


@kernel()
def _fill_grid(grid: _Grid) -> None:
    """Count the faces of each cell in `starts`; if `order` is not empty, also write the face indices to `order`."""
    counts, starts, boxes = grid.counts, grid.starts, grid.mesh.boxes
    for k in range(len(boxes)):
        x, x_last = _cell_range(boxes[k, 0, 0], boxes[k, 1, 0], grid.low[0], grid.side_mm, counts[0])
        y, y_last = _cell_range(boxes[k, 0, 1], boxes[k, 1, 1], grid.low[1], grid.side_mm, counts[1])
        z, z_last = _cell_range(boxes[k, 0, 2], boxes[k, 1, 2], grid.low[2], grid.side_mm, counts[2])
        for i in range(z, z_last + 1):
            for j in range(y, y_last + 1):
                row = (i * counts[1] + j) * counts[0]
                for cell in range(row + x, row + x_last + 1):
                    if len(grid.order):
                        starts[cell] -= 1
                        grid.order[starts[cell]] = k
                    else:
                        starts[cell] += 1
    if not len(grid.order):
        for cell in range(1, len(starts)):
            starts[cell] += starts[cell - 1]


@kernel()
def _has_intersecting_faces(faces: _Faces, grid: _Grid) -> bool:
    """Report whether any face of a mesh intersects a face in the grid of another mesh."""
    counts, boxes, around = grid.counts, faces.boxes, grid.mesh.boxes
    for k in range(len(boxes)):
        x, x_last = _cell_range(boxes[k, 0, 0], boxes[k, 1, 0], grid.low[0], grid.side_mm, counts[0])
        y, y_last = _cell_range(boxes[k, 0, 1], boxes[k, 1, 1], grid.low[1], grid.side_mm, counts[1])
        z, z_last = _cell_range(boxes[k, 0, 2], boxes[k, 1, 2], grid.low[2], grid.side_mm, counts[2])
        x_low, y_low, z_low = (
            boxes[k, 0, 0] - _CONTACT_DISTANCE_MM,
            boxes[k, 0, 1] - _CONTACT_DISTANCE_MM,
            boxes[k, 0, 2] - _CONTACT_DISTANCE_MM,
        )
        x_high, y_high, z_high = (
            boxes[k, 1, 0] + _CONTACT_DISTANCE_MM,
            boxes[k, 1, 1] + _CONTACT_DISTANCE_MM,
            boxes[k, 1, 2] + _CONTACT_DISTANCE_MM,
        )
        if x > x_last:
            continue
        for i in range(z, z_last + 1):
            for j in range(y, y_last + 1):
                row = (i * counts[1] + j) * counts[0]
                for n in range(grid.starts[row + x], grid.starts[row + x_last + 1]):
                    m = grid.order[n]
                    if around[m, 0, 0] > x_high or around[m, 1, 0] < x_low or around[m, 0, 1] > y_high:
                        continue
                    if around[m, 1, 1] < y_low or around[m, 0, 2] > z_high or around[m, 1, 2] < z_low:
                        continue
                    if _is_on_one_side(faces.corners[k], grid.mesh.planes[m]) or _is_on_one_side(
                        grid.mesh.corners[m], faces.planes[k]
                    ):
                        continue
                    if _is_face_pair_intersecting(faces.corners[k], grid.mesh.corners[m]):
                        return True
    return False


@kernel_helper()
def _is_on_one_side(face: Array, plane: Array) -> bool:
    """Report whether a face (3, 3) is entirely on one side of a plane (4,)."""
    one = face[0, 0] * plane[0] + face[0, 1] * plane[1] + face[0, 2] * plane[2] - plane[3]
    two = face[1, 0] * plane[0] + face[1, 1] * plane[1] + face[1, 2] * plane[2] - plane[3]
    three = face[2, 0] * plane[0] + face[2, 1] * plane[1] + face[2, 2] * plane[2] - plane[3]
    return min(one, two, three) > _CONTACT_DISTANCE_MM or max(one, two, three) < -_CONTACT_DISTANCE_MM


@kernel_helper()
def _is_face_pair_intersecting(one: Array, other: Array) -> bool:
    """Report whether two faces (3, 3) intersect, which is the case if no cross product of edges separates them."""
    for i in range(3):
        j = (i + 1) % 3
        ux, uy, uz = one[j, 0] - one[i, 0], one[j, 1] - one[i, 1], one[j, 2] - one[i, 2]
        for m in range(3):
            n = (m + 1) % 3
            vx, vy, vz = other[n, 0] - other[m, 0], other[n, 1] - other[m, 1], other[n, 2] - other[m, 2]
            if _is_separated_along(one, other, uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx):
                return False
    return True


@kernel_helper()
def _is_separated_along(one: Array, other: Array, x: float, y: float, z: float) -> bool:
    """Report whether the axis (x, y, z) separates two faces (3, 3); a zero vector never separates two faces."""
    a, b, c = (
        one[0, 0] * x + one[0, 1] * y + one[0, 2] * z,
        one[1, 0] * x + one[1, 1] * y + one[1, 2] * z,
        one[2, 0] * x + one[2, 1] * y + one[2, 2] * z,
    )
    d, e, f = (
        other[0, 0] * x + other[0, 1] * y + other[0, 2] * z,
        other[1, 0] * x + other[1, 1] * y + other[1, 2] * z,
        other[2, 0] * x + other[2, 1] * y + other[2, 2] * z,
    )
    gap = max(min(d, e, f) - max(a, b, c), min(a, b, c) - max(d, e, f))
    return gap > 0.0 and gap * gap > _CONTACT_DISTANCE_MM * _CONTACT_DISTANCE_MM * (x * x + y * y + z * z)


@kernel()
def _winding_number(place: Array, faces: Array) -> float:
    """Compute the winding number around a point (3,) for a closed mesh with faces (n, 3, 3)."""
    total = 0.0
    for k in range(len(faces)):
        ax, ay, az = faces[k, 0, 0] - place[0], faces[k, 0, 1] - place[1], faces[k, 0, 2] - place[2]
        bx, by, bz = faces[k, 1, 0] - place[0], faces[k, 1, 1] - place[1], faces[k, 1, 2] - place[2]
        cx, cy, cz = faces[k, 2, 0] - place[0], faces[k, 2, 1] - place[1], faces[k, 2, 2] - place[2]
        a, b, c = (
            math.sqrt(ax * ax + ay * ay + az * az),
            math.sqrt(bx * bx + by * by + bz * bz),
            math.sqrt(cx * cx + cy * cy + cz * cz),
        )
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
        total += math.atan2(volume, a * b * c + ab * c + bc * a + ca * b)
    return total / (2 * math.pi)
