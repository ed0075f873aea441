"""Meshes as numbers: which edges balance, which corners are one, which faces hang together, what they enclose."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.checks import Array

Faces = NDArray[np.int32]


@njit(cache=True, nogil=True)
def narrowed(faces: NDArray[np.integer], count: int, narrow: Faces) -> int:
    """Copy faces into int32; returns how many vertices they name that are not there."""
    stray = 0
    for k in range(len(faces)):
        for corner in range(3):
            vertex = faces[k, corner]
            if not 0 <= vertex < count:
                stray += 1
            narrow[k, corner] = vertex
    return stray


@njit(cache=True, nogil=True)
def _mixed(key: np.uint64) -> np.uint64:
    """SplitMix64 (Steele et al. 2014)."""
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.uint64(key ^ (key >> np.uint64(31)))


@njit(cache=True, nogil=True)
def edge_sum(faces: Faces) -> np.uint64:
    """Hashes of the undirected edges, added when run upwards and taken away when run downwards.

    0 if every directed edge stands as often as its reverse does, and by accident once in 1e19.
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


@njit(cache=True, nogil=True)
def distinct(rows: Array) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """First place of each distinct row of (n, 3), in order, and for every row the number of its like."""
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
        while table[slot] >= 0 and (rows[first[table[slot]]] != rows[k]).any():
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = count
            first[count] = k
            count += 1
        number[k] = table[slot]
    return first[:count].copy(), number


@njit(cache=True, nogil=True)
def bodies(faces: Faces, count: int) -> tuple[NDArray[np.int32], int]:
    """Number of the connected body of each vertex, and how many there are (union-find)."""
    parent = np.arange(count).astype(np.int32)
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


@njit(cache=True, nogil=True)
def volumes_mm3(points: Array, faces: NDArray[np.int32], body: NDArray[np.int32], count: int) -> Array:
    """(count,)  signed volume of each body, mm3"""
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


@njit(cache=True, nogil=True)
def winding(points: Array, faces: Faces, at: Array) -> float:
    """How often faces go around a point: their solid angle over 4 pi (Van Oosterom and Strackee 1983, eq. 8)."""
    total = 0.0
    for k in range(len(faces)):
        a, b, c = points[faces[k, 0]] - at, points[faces[k, 1]] - at, points[faces[k, 2]] - at
        la, lb, lc = np.sqrt((a * a).sum()), np.sqrt((b * b).sum()), np.sqrt((c * c).sum())
        triple = a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
        triple += a[2] * (b[0] * c[1] - b[1] * c[0])
        rest = la * lb * lc + (a * b).sum() * lc + (b * c).sum() * la + (c * a).sum() * lb
        total += np.arctan2(triple, rest)
    return total / (2 * np.pi)


def used(points: Array, faces: Faces) -> tuple[Array, Faces]:
    """Without the vertices that no face has."""
    named = np.zeros(len(points), np.bool_)
    named[faces.ravel()] = True
    if named.all():
        return points, faces
    return points[named], (np.cumsum(named) - 1).astype(np.int32)[faces]
