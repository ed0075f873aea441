"""What a ray met, taken from one beside it: the same triangles, or those across their edges.

How many crossings a ray has is known; as many triangles that it lies strictly inside of, one behind the other, are all
that it meets, wherever they were taken from. So most rays need not be cast.
"""

from typing import NamedTuple

import numpy as np

from ..core.checks import Array
from ..core.compiled import callee, kernel
from .casting import Ints, Progress, Spot, depth_within, load_facet, spot_of
from .crossings import Crossings
from .sheets import Frame, Triangles

# Of so many rows and columns one is cast first; triangles are looked for across so many edges.
GRID, WALK_LIMIT = 5, 4


class Near(NamedTuple):
    """The triangles that the last pixel lies in, one behind the other, and what lies beside all.

    across   (m, 3)   as `across_edges` gives it
    numbers  (most,)  of the triangles
    facets   (most, 16)  what `load_facet` makes of them
    """

    triangles: Triangles
    across: Ints
    numbers: Ints
    facets: Array


@kernel()
def spread(triangles: Triangles, frame: Frame, listed: Crossings, progress: Progress, most: int) -> None:
    """Give pixels the triangles of one cast nearby, where they lie strictly inside every one of them."""
    rows, cols, starts, facets = listed.window.rows, listed.window.cols, listed.starts, np.empty((most, 16))
    across = (cols + GRID - 1) // GRID
    for n in range((rows + GRID - 1) // GRID * across):
        top, left = n // across * GRID, n % across * GRID
        anchor = top * cols + left
        first, number = starts[anchor], starts[anchor + 1] - starts[anchor]
        if number == 0 or progress.left[anchor] or progress.doubt[anchor]:
            continue
        for k in range(number):
            load_facet(triangles, progress.met[first + k], facets, k)
        for row in range(max(top - GRID + 1, 0), min(top + GRID, rows)):
            for col in range(max(left - GRID + 1, 0), min(left + GRID, cols)):
                pixel = row * cols + col
                if progress.left[pixel] != number:
                    continue
                place, at, spot = starts[pixel], 0.0, spot_of(frame, listed.window.row + row, listed.window.col + col)
                for k in range(number):
                    at = depth_within(spot, facets, k, at)
                    if at == 0.0:
                        break
                    listed.depth[place + k], listed.sign[place + k] = at, listed.sign[first + k]
                    progress.met[place + k] = progress.met[first + k]
                if at > 0.0:
                    progress.left[pixel], progress.turns[pixel] = 0, progress.turns[anchor]


@callee()
def _outer_edge(spot: Spot, facets: Array, k: int) -> int:
    """Number of an edge of triangle k of `load_facet` that a pixel is not strictly inside of; 3 if there is none."""
    for corner in range(3):
        e = 4 * corner
        turn = facets[k, e + 3] * (spot.row - facets[k, e]) - (spot.col - facets[k, e + 1]) * facets[k, e + 2]
        if not turn * facets[k, 15] > 0.0:
            return corner
    return 3


@kernel()
def across_edges(faces: Ints, count: int) -> Ints:
    """(m, 3)  the face across each edge of faces (m, 3) of so many vertices, from each corner to the next; -1: none"""
    first, after, across = np.empty(count, np.int32), np.empty(faces.size, np.int32), np.empty_like(faces)
    for vertex in range(count):
        first[vertex] = -1
    for edge in range(faces.size):
        start = faces[edge // 3, edge % 3]
        after[edge], first[start] = first[start], edge
    for edge in range(faces.size):
        across[edge // 3, edge % 3] = -1
        other = first[faces[edge // 3, (edge % 3 + 1) % 3]]
        while other >= 0:
            if faces[other // 3, (other % 3 + 1) % 3] == faces[edge // 3, edge % 3]:
                across[edge // 3, edge % 3] = other // 3
                break
            other = after[other]
    return across


@callee()
def _walk(near: Near, spot: Spot, pixel: int, listed: Crossings, progress: Progress) -> bool:
    """Give a pixel triangles on from those of one beside it, from each to the next; whether all are strictly around it.

    As many as it has crossings, one behind the other, are all that it has.
    """
    place, at, turns = listed.starts[pixel], 0.0, 0
    for k in range(listed.starts[pixel + 1] - place):
        steps, edge = 0, _outer_edge(spot, near.facets, k)
        while edge < 3:
            triangle = near.across[near.numbers[k], edge]
            if triangle < 0 or steps == WALK_LIMIT:
                return False
            load_facet(near.triangles, triangle, near.facets, k)
            near.numbers[k] = triangle
            steps, edge = steps + 1, _outer_edge(spot, near.facets, k)
        before, scaled = at, near.facets[k, 15]
        at = scaled / (near.facets[k, 12] * spot.x + near.facets[k, 13] * spot.y + near.facets[k, 14] * spot.z)
        if not at > before:
            return False
        sign = 1 if scaled > 0.0 else -1
        listed.depth[place + k], listed.sign[place + k], progress.met[place + k] = at, sign, near.numbers[k]
        turns += sign
    progress.left[pixel], progress.turns[pixel] = 0, turns
    return True


@kernel()
def walk_on(near: Near, frame: Frame, listed: Crossings, progress: Progress, way: int) -> None:
    """Give pixels the triangles of one beside them, or theirs across an edge, where they lie strictly inside them.

    way  +1: from left to right and downwards, after pixels to the left or above; -1: back
    """
    rows, cols, starts = listed.window.rows, listed.window.cols, listed.starts
    for n in range(rows) if way > 0 else range(rows - 1, -1, -1):
        loaded = -1
        for m in range(cols) if way > 0 else range(cols - 1, -1, -1):
            pixel = n * cols + m
            number = starts[pixel + 1] - starts[pixel]
            if progress.left[pixel] != number or number == 0:
                continue
            spot = spot_of(frame, listed.window.row + n, listed.window.col + m)
            for beside, exists in ((pixel - way, 0 <= m - way < cols), (pixel - way * cols, 0 <= n - way < rows)):
                if not exists or starts[beside + 1] - starts[beside] != number:
                    continue
                if progress.left[beside] or progress.doubt[beside]:
                    continue
                for k in range(number if loaded != beside else 0):
                    if loaded < 0 or near.numbers[k] != progress.met[starts[beside] + k]:
                        near.numbers[k] = progress.met[starts[beside] + k]
                        load_facet(near.triangles, near.numbers[k], near.facets, k)
                loaded = pixel
                if _walk(near, spot, pixel, listed, progress):
                    break
