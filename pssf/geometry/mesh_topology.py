"""Topology of triangle meshes: edge balance, duplicates, connected components (bodies) and volumes."""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper

Faces = NDArray[np.int32]


def convert_faces_to_int32(faces: NDArray[np.integer], count: int) -> tuple[Faces, int]:
    """Convert faces to int32 and count invalid vertex indices.

    Parameters
    ----------
    faces : (m, 3) integer array
        Vertex indices of each face.
    count : int
        Number of vertices.

    Returns
    -------
    faces : (m, 3) int32 array
        Copy of the vertex indices as int32.
    stray : int
        Number of vertex indices outside the range from 0 to `count` - 1.
    """
    return faces.astype(np.int32, order="C"), int(np.count_nonzero((faces < 0) | (faces >= count)))


@kernel_helper()
def _mix_hash(key: np.uint64) -> np.uint64:
    """Compute the hash of a 64-bit key with the SplitMix64 algorithm (Steele et al. 2014)."""
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.uint64(key ^ (key >> np.uint64(31)))


@kernel()
def hash_edge_balance(faces: Faces) -> np.uint64:
    """Add up the hashes of all edges, with opposite signs for the two directions of an edge.

    Parameters
    ----------
    faces : (m, 3) int32 array
        Vertex indices of each face.

    Returns
    -------
    uint64
        Sum of the hashes, which is 0 if every edge occurs equally often in both directions. The probability of a sum of
        0 for any other mesh is 1e-19.
    """
    total = np.uint64(0)
    for k in range(len(faces)):
        for corner in range(3):
            one, other = faces[k, corner], faces[k, (corner + 1) % 3]
            low, high = np.uint64(min(one, other)), np.uint64(max(one, other))
            key = _mix_hash(low * np.uint64(0x9E3779B97F4A7C15) + high * np.uint64(0xD1B54A32D192ED03))
            if one < other:
                total += key
            elif other < one:
                total -= key
    return total


@kernel()
def find_distinct_rows(rows: Array) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Find distinct rows by bitwise comparison, so that -0.0 differs from 0.0, and identical NaN values are equal.

    Parameters
    ----------
    rows : (n, 3) float64 array, any unit
        Rows to compare.

    Returns
    -------
    first : (k,) int64 array
        Index of the first occurrence of each distinct row, in ascending order.
    number : (n,) int32 array
        Index into `first` for each row, which identifies the equal distinct row.
    """
    size = 1
    while size < 2 * len(rows):
        size *= 2
    table = np.full(size, -1, np.int64)
    first = np.empty(len(rows), np.int64)
    number = np.empty(len(rows), np.int32)
    bits = rows.view(np.uint64)
    count = 0
    for k in range(len(rows)):
        slot = np.int64(_mix_hash(_mix_hash(_mix_hash(bits[k, 0]) + bits[k, 1]) + bits[k, 2]) & np.uint64(size - 1))
        while table[slot] >= 0 and (bits[first[table[slot]]] != bits[k]).any():
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = count
            first[count] = k
            count += 1
        number[k] = table[slot]
    return first[:count].copy(), number


def find_degenerate_faces(faces: Faces) -> NDArray[np.bool_]:
    """Find faces with a repeated vertex, which do not affect whether a mesh is closed.

    Parameters
    ----------
    faces : (m, 3) int32 array
        Vertex indices of each face.

    Returns
    -------
    (m,) bool array
        True for each degenerate face.
    """
    a, b, c = faces.T
    return np.asarray((a == b) | (b == c) | (c == a))


@kernel()
def count_repeated_faces(points: Array, faces: Faces) -> int:
    """Count faces that repeat an earlier face with the same corner positions and the same winding.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Vertices, in which -0.0 has been replaced by 0.0.
    faces : (m, 3) int32 array
        Vertex indices of each face. Faces with a repeated vertex are ignored.

    Returns
    -------
    int
        Number of repeated faces. The number is too large by 1 with a probability of m**2 / 1e19 (hash collision).
    """
    bits, place = points.view(np.uint64), np.empty(len(points), np.uint64)
    for k in range(len(points)):
        place[k] = _mix_hash(_mix_hash(_mix_hash(bits[k, 0]) + bits[k, 1]) + bits[k, 2])
    size = 1
    while size < 2 * len(faces):
        size *= 2
    table = np.zeros(size, np.uint64)
    count = 0
    for k in range(len(faces)):
        a, b, c = place[faces[k, 0]], place[faces[k, 1]], place[faces[k, 2]]
        if a == b or b == c or c == a:
            continue
        # The corners are rotated, so that the key depends on the winding but not on the choice of the first corner.
        if b < a and b < c:
            a, b, c = b, c, a
        elif c < a and c < b:
            a, b, c = c, a, b
        key = _mix_hash(_mix_hash(a + np.uint64(0x9E3779B97F4A7C15) * b) + c) | np.uint64(1)
        slot = np.int64((key >> np.uint64(1)) & np.uint64(size - 1))
        while table[slot] != 0 and table[slot] != key:
            slot = (slot + 1) & (size - 1)
        count += table[slot] == key
        table[slot] = key
    return count


@kernel()
def label_bodies(faces: Faces, count: int) -> tuple[NDArray[np.int32], int]:
    """Label the connected components (bodies) of a mesh by union-find.

    Parameters
    ----------
    faces : (m, 3) int32 array
        Vertex indices of each face.
    count : int
        Number of vertices.

    Returns
    -------
    number : (count,) int32 array
        Index of the body of each vertex.
    bodies : int
        Number of bodies.
    """
    parent = np.empty(count, np.int32)
    for vertex in range(count):
        parent[vertex] = vertex
    for k in range(len(faces)):
        for corner in range(1, 3):
            one, other = faces[k, 0], faces[k, corner]
            while parent[one] != one:
                parent[one] = parent[parent[one]]
                one = parent[one]
            while parent[other] != other:
                parent[other] = parent[parent[other]]
                other = parent[other]
            if one < other:
                parent[other] = one
            else:
                parent[one] = other
    bodies = 0
    number = np.empty(count, np.int32)
    for vertex in range(count):
        # A parent never has a higher index than a child, so each root is labelled before its children.
        if parent[vertex] == vertex:
            number[vertex] = bodies
            bodies += 1
        else:
            number[vertex] = number[parent[vertex]]
    return number, bodies


@kernel()
def body_volumes_mm3(points: Array, faces: NDArray[np.int32], body: NDArray[np.int32], count: int) -> Array:
    """Compute the signed volume of each body of a mesh.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Vertices.
    faces : (m, 3) int32 array
        Vertex indices of each face.
    body : (n,) int32 array
        Index of the body of each vertex, from 0 to `count` - 1.
    count : int
        Number of bodies.

    Returns
    -------
    (count,) float64 array
        Volume of each body, in mm3; negative if the faces of the body point inward.
    """
    volumes = np.zeros(count)
    o = points[faces[0, 0]]
    for k in range(len(faces)):
        a, b, c = points[faces[k, 0]], points[faces[k, 1]], points[faces[k, 2]]
        ax, ay, az = a[0] - o[0], a[1] - o[1], a[2] - o[2]
        bx, by, bz = b[0] - o[0], b[1] - o[1], b[2] - o[2]
        cx, cy, cz = c[0] - o[0], c[1] - o[1], c[2] - o[2]
        product = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        volumes[body[faces[k, 0]]] += product / 6
    return volumes


def find_used_vertices(faces: Faces, count: int) -> NDArray[np.bool_]:
    """Find the vertices that belong to at least one face.

    Parameters
    ----------
    faces : (m, 3) int32 array
        Vertex indices of each face.
    count : int
        Number of vertices.

    Returns
    -------
    (count,) bool array
        True for each used vertex.
    """
    marks = np.zeros(count, np.bool_)
    marks[faces.reshape(-1)] = True
    return marks


def drop_unused_vertices(points: Array, faces: Faces) -> tuple[Array, Faces]:
    """Remove the vertices that do not belong to any face.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Vertices.
    faces : (m, 3) int32 array
        Vertex indices of each face.

    Returns
    -------
    points : (k, 3) float64 array
        Remaining vertices, in mm.
    faces : (m, 3) int32 array
        Faces with the new vertex indices.
    """
    marks = find_used_vertices(faces, len(points))
    if marks.all():
        return points, faces
    return points[marks], (np.cumsum(marks) - 1).astype(np.int32)[faces]
