"""Reuse the triangles of neighbouring pixels, so that most rays need not be cast.

The number of crossings of each ray is known. If a pixel is strictly inside the same number of projected triangles, its
ray crosses exactly these triangles. Candidates are the triangles of a neighbouring pixel, and the triangles adjacent to
them.
"""

from typing import NamedTuple

import numpy as np

from ...core.checks import Array
from ...core.numba_kernel import kernel, kernel_helper
from .crossings import Crossings
from .projected_surface import RayFrame, Triangles
from .ray_state import (
    CastProgress,
    Ints,
    PixelRay,
    hit_depth,
    load_facet,
    make_pixel_ray,
)

# Spacing of the grid of pixels whose rays are cast first, in rows and columns.
GRID = 5
# Maximum number of steps from a triangle of the neighbouring pixel to adjacent triangles.
WALK_LIMIT = 4


class NeighbourTriangles(NamedTuple):
    """Triangles that the ray of the previous pixel crosses, and the adjacency of all triangles of the surface.

    Attributes
    ----------
    triangles : Triangles
        All triangles of the surface.
    adjacent_faces : (m, 3) int32 array
        Number of the adjacent face across each edge, from `find_adjacent_faces`.
    triangle_numbers : (max_triangles,) int32 array
        Numbers of the triangles that the ray of the previous pixel crosses, sorted by depth; `max_triangles` is the
        largest number of triangles that a ray crosses.
    facets : (max_triangles, 16) float64 array, mm and px
        Edges (12 numbers) and planes (4 numbers) of the triangles in `triangle_numbers`, from `load_facet`.
    """

    triangles: Triangles
    adjacent_faces: Ints
    triangle_numbers: Ints
    facets: Array


@kernel()
def reuse_from_grid(
    triangles: Triangles, frame: RayFrame, crossings: Crossings, progress: CastProgress, max_crossings: int
) -> None:
    """Reuse the triangles of each grid pixel for nearby pixels that are strictly inside all of these triangles.

    Parameters
    ----------
    triangles : Triangles
        Triangles of the surface.
    frame : RayFrame
        Source and pixels that define the rays.
    crossings : Crossings
        Crossings of the window; filled in place.
    progress : CastProgress
        State of the pixels; updated in place.
    max_crossings : int
        Largest number of crossings of any ray in the window.
    """
    rows, cols, starts, facets = (
        crossings.window.rows,
        crossings.window.cols,
        crossings.starts,
        np.empty((max_crossings, 16)),
    )
    across = (cols + GRID - 1) // GRID
    for n in range((rows + GRID - 1) // GRID * across):
        top, left = n // across * GRID, n % across * GRID
        anchor = top * cols + left
        first, number = starts[anchor], starts[anchor + 1] - starts[anchor]
        if number == 0 or progress.remaining[anchor] or progress.suspect[anchor]:
            continue
        for k in range(number):
            load_facet(triangles, progress.hit_triangles[first + k], facets, k)
        for row in range(max(top - GRID + 1, 0), min(top + GRID, rows)):
            for col in range(max(left - GRID + 1, 0), min(left + GRID, cols)):
                pixel = row * cols + col
                if progress.remaining[pixel] != number:
                    continue
                place, at, spot = (
                    starts[pixel],
                    0.0,
                    make_pixel_ray(frame, crossings.window.row + row, crossings.window.col + col),
                )
                for k in range(number):
                    at = hit_depth(spot, facets, k, at)
                    if at == 0.0:
                        break
                    crossings.depth[place + k], crossings.sign[place + k] = at, crossings.sign[first + k]
                    progress.hit_triangles[place + k] = progress.hit_triangles[first + k]
                if at > 0.0:
                    progress.remaining[pixel], progress.sign_sum[pixel] = 0, progress.sign_sum[anchor]


@kernel_helper()
def _find_outer_edge(pixel_ray: PixelRay, facets: Array, k: int) -> int:
    """Return the number of an edge of triangle k that has the pixel on its outer side, or 3 if there is none."""
    for corner in range(3):
        e = 4 * corner
        turn = facets[k, e + 3] * (pixel_ray.row - facets[k, e]) - (pixel_ray.col - facets[k, e + 1]) * facets[k, e + 2]
        if not turn * facets[k, 15] > 0.0:
            return corner
    return 3


@kernel()
def find_adjacent_faces(faces: Ints, count: int) -> Ints:
    """Find the adjacent face across each edge of each face.

    Parameters
    ----------
    faces : (m, 3) int32 array
        Vertex numbers of the faces.
    count : int
        Number of vertices.

    Returns
    -------
    (m, 3) int32 array
        Number of the face across the edge from each corner to the next corner; -1 at a boundary edge.
    """
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


@kernel_helper()
def _walk_to_pixel(
    near: NeighbourTriangles, pixel_ray: PixelRay, pixel: int, crossings: Crossings, progress: CastProgress
) -> bool:
    """Replace triangles of a neighbouring pixel by adjacent triangles until they contain the current pixel.

    The search starts from the triangles crossed by the neighbouring ray. Each triangle is replaced by an adjacent
    triangle until its projection contains the current pixel. Returns True if the replacement succeeds for all crossings
    of the ray.

    If the number of these triangles equals the number of crossings, the ray crosses exactly these triangles.
    """
    place, at, turns = crossings.starts[pixel], 0.0, 0
    for k in range(crossings.starts[pixel + 1] - place):
        steps, edge = 0, _find_outer_edge(pixel_ray, near.facets, k)
        while edge < 3:
            triangle = near.adjacent_faces[near.triangle_numbers[k], edge]
            if triangle < 0 or steps == WALK_LIMIT:
                return False
            load_facet(near.triangles, triangle, near.facets, k)
            near.triangle_numbers[k] = triangle
            steps, edge = steps + 1, _find_outer_edge(pixel_ray, near.facets, k)
        before, scaled = at, near.facets[k, 15]
        at = scaled / (
            near.facets[k, 12] * pixel_ray.x + near.facets[k, 13] * pixel_ray.y + near.facets[k, 14] * pixel_ray.z
        )
        if not at > before:
            return False
        sign = 1 if scaled > 0.0 else -1
        crossings.depth[place + k], crossings.sign[place + k], progress.hit_triangles[place + k] = (
            at,
            sign,
            near.triangle_numbers[k],
        )
        turns += sign
    progress.remaining[pixel], progress.sign_sum[pixel] = 0, turns
    return True


@kernel()
def reuse_from_neighbours(
    near: NeighbourTriangles, frame: RayFrame, crossings: Crossings, progress: CastProgress, direction: int
) -> None:
    """Reuse the triangles of a neighbouring pixel, or adjacent triangles, for pixels strictly inside these triangles.

    Parameters
    ----------
    near : NeighbourTriangles
        Triangles of the previous pixel, which are overwritten, and the adjacency of all triangles.
    frame : RayFrame
        Source and pixels that define the rays.
    crossings : Crossings
        Crossings of the window; filled in place.
    progress : CastProgress
        State of the pixels; updated in place.
    direction : int
        +1 scans right and down, with neighbours on the left and above. -1 scans left and up, with neighbours on the
        right and below.
    """
    rows, cols, starts = crossings.window.rows, crossings.window.cols, crossings.starts
    for n in range(rows) if direction > 0 else range(rows - 1, -1, -1):
        loaded = -1
        for m in range(cols) if direction > 0 else range(cols - 1, -1, -1):
            pixel = n * cols + m
            number = starts[pixel + 1] - starts[pixel]
            if progress.remaining[pixel] != number or number == 0:
                continue
            spot = make_pixel_ray(frame, crossings.window.row + n, crossings.window.col + m)
            for beside, exists in (
                (pixel - direction, 0 <= m - direction < cols),
                (pixel - direction * cols, 0 <= n - direction < rows),
            ):
                if not exists or starts[beside + 1] - starts[beside] != number:
                    continue
                if progress.remaining[beside] or progress.suspect[beside]:
                    continue
                for k in range(number if loaded != beside else 0):
                    if loaded < 0 or near.triangle_numbers[k] != progress.hit_triangles[starts[beside] + k]:
                        near.triangle_numbers[k] = progress.hit_triangles[starts[beside] + k]
                        load_facet(near.triangles, near.triangle_numbers[k], near.facets, k)
                loaded = pixel
                if _walk_to_pixel(near, spot, pixel, crossings, progress):
                    break
