"""Meshes as numbers: which edges balance, which corners and faces are one, what hangs together, what it encloses."""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel

Faces = NDArray[np.int32]


def narrowed(faces: NDArray[np.integer], count: int) -> tuple[Faces, int]:
    """A copy of faces in int32, and how many vertices they name that are not there.

    faces    (m, 3)  vertex numbers of any integer type
    count    vertices that there are
    returns  (m, 3) vertex numbers, and those that are none
    """
    return faces.astype(np.int32, order="C"), int(np.count_nonzero((faces < 0) | (faces >= count)))


@callee()
def _mixed(key: np.uint64) -> np.uint64:
    """SplitMix64 (Steele et al. 2014)."""
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.uint64(key ^ (key >> np.uint64(31)))


@kernel()
def edge_sum(faces: Faces) -> np.uint64:
    """Hashes of the undirected edges, added when run upwards and taken away when run downwards.

    faces    (m, 3)  vertex numbers
    returns  0 if every directed edge stands as often as its reverse does, and by accident once in 1e19
    """
    total = np.uint64(0)
    for k in range(len(faces)):
        for corner in range(3):
            one, other = faces[k, corner], faces[k, (corner + 1) % 3]
            low, high = np.uint64(min(one, other)), np.uint64(max(one, other))
            key = _mixed(low * np.uint64(0x9E3779B97F4A7C15) + high * np.uint64(0xD1B54A32D192ED03))
            if one < other:
                total += key
            elif other < one:
                total -= key
    return total


@kernel()
def distinct(rows: Array) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Which rows are one, bit for bit: -0.0 is not 0.0, and NaN is NaN.

    rows     (n, 3)  any unit
    returns  (k,) where each distinct row stands first, in order; and (n,) for every row the number of its like
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
        slot = np.int64(_mixed(_mixed(_mixed(bits[k, 0]) + bits[k, 1]) + bits[k, 2]) & np.uint64(size - 1))
        while table[slot] >= 0 and (bits[first[table[slot]]] != bits[k]).any():
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = count
            first[count] = k
            count += 1
        number[k] = table[slot]
    return first[:count].copy(), number


def pointed(faces: Faces) -> NDArray[np.bool_]:
    """(m,)  which faces name a vertex twice; with or without them, a mesh is as closed

    faces  (m, 3)  vertex numbers
    """
    a, b, c = faces.T
    return np.asarray((a == b) | (b == c) | (c == a))


@kernel()
def repeats(points: Array, faces: Faces) -> int:
    """How many faces stand where one before them does, wound the same way, whatever the numbers of their corners.

    points   (n, 3)  mm, without -0.0
    faces    (m, 3)  vertex numbers; those that name a vertex twice are passed over
    returns  their number, by hashes: one too many by accident once in 1e19 / m**2
    """
    bits, place = points.view(np.uint64), np.empty(len(points), np.uint64)
    for k in range(len(points)):
        place[k] = _mixed(_mixed(_mixed(bits[k, 0]) + bits[k, 1]) + bits[k, 2])
    size = 1
    while size < 2 * len(faces):
        size *= 2
    table = np.zeros(size, np.uint64)
    count = 0
    for k in range(len(faces)):
        a, b, c = place[faces[k, 0]], place[faces[k, 1]], place[faces[k, 2]]
        if a == b or b == c or c == a:
            continue
        # The same key whichever corner comes first, and another for the reverse.
        if b < a and b < c:
            a, b, c = b, c, a
        elif c < a and c < b:
            a, b, c = c, a, b
        key = _mixed(_mixed(a + np.uint64(0x9E3779B97F4A7C15) * b) + c) | np.uint64(1)
        slot = np.int64((key >> np.uint64(1)) & np.uint64(size - 1))
        while table[slot] != 0 and table[slot] != key:
            slot = (slot + 1) & (size - 1)
        count += table[slot] == key
        table[slot] = key
    return count


@kernel()
def bodies(faces: Faces, count: int) -> tuple[NDArray[np.int32], int]:
    """Which vertices hang together by faces (union-find).

    faces    (m, 3)  vertex numbers
    count    vertices that there are
    returns  (count,) number of the connected body of each vertex, and how many there are
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
        # Roots come first: a parent's number is never above its child's.
        if parent[vertex] == vertex:
            number[vertex] = bodies
            bodies += 1
        else:
            number[vertex] = number[parent[vertex]]
    return number, bodies


@kernel()
def volumes_mm3(points: Array, faces: NDArray[np.int32], body: NDArray[np.int32], count: int) -> Array:
    """(count,)  signed volume of each body, mm3

    points  (n, 3)  mm
    faces   (m, 3)  vertex numbers
    body    (n,)    number of the body of each vertex, below `count`
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


def named(faces: Faces, count: int) -> NDArray[np.bool_]:
    """(count,)  which vertices some face has

    faces  (m, 3)  vertex numbers
    """
    marks = np.zeros(count, np.bool_)
    marks[faces.reshape(-1)] = True
    return marks


def used(points: Array, faces: Faces) -> tuple[Array, Faces]:
    """A mesh without the vertices that no face has.

    points   (n, 3)  mm
    faces    (m, 3)  vertex numbers
    returns  (k, 3) points and (m, 3) faces by their new numbers
    """
    marks = named(faces, len(points))
    if marks.all():
        return points, faces
    return points[marks], (np.cumsum(marks) - 1).astype(np.int32)[faces]
