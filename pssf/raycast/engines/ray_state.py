"""State of the rays that are being cast, and restart of the rays after each hit."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.numba_kernel import kernel, kernel_helper
from .crossings import Crossings
from .projected_surface import Point, RayFrame, Triangles

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

# Spacing of float32 numbers near 1.
FLOAT32_EPSILON = float(np.finfo(np.float32).eps)

# Distance behind a hit triangle at which a ray restarts, in float32 spacings. The distance is measured along the normal
# of the triangle, because a step along a grazing ray would hit the triangle again. The distance exceeds the
# rounding error. At 100 mm from the surface centre, two layers closer than 4e-5 mm are skipped together.
RESTART_EPSILONS = 3.0

# Maximum number of repeated hits of the same triangle; a ray with more repeated hits is recomputed.
REPEAT_HIT_LIMIT = 8


class Rays(NamedTuple):
    """Rays that are being cast; active rays are at the start of each array.

    Attributes
    ----------
    origins : (n, 3) float32 array, mm
        Start points of the rays, relative to the centre of the surface.
    directions : (n, 3) float32 array, dimensionless
        Ray directions, as unit vectors.
    pixels : (n,) int32 array
        Pixel number of each ray within the window.
    depths : (n,) float64 array, dimensionless
        Depth of the last hit, as a fraction of the source-to-pixel distance.
    triangles : (n,) int32 array
        Number of the last triangle hit; -1 before the first hit.
    repeat_hits : (n,) int32 array
        Number of consecutive repeated hits of the same triangle.
    """

    origins: Floats
    directions: Floats
    pixels: Ints
    depths: Array
    triangles: Ints
    repeat_hits: Ints


class Extent(NamedTuple):
    """Centre and depth range of a surface.

    Attributes
    ----------
    centre : Point
        Centre of the surface, in mm.
    near, far : float
        Depths just in front of and just behind the surface, as fractions of the source-to-detector distance.
    """

    centre: Point
    near: float
    far: float


class CastProgress(NamedTuple):
    """Progress of ray casting for each pixel of a window.

    Attributes
    ----------
    remaining : (pixels,) int32 array
        Number of crossings that are not yet found.
    sign_sum : (pixels,) int32 array
        Sum of the signs of all crossings found so far.
    suspect : (pixels,) bool array
        True if the ray of the pixel has an unreliable hit.
    hit_triangles : (crossings,) int32 array
        Triangle number of each crossing.
    """

    remaining: Ints
    sign_sum: Ints
    suspect: NDArray[np.bool_]
    hit_triangles: Ints


class PixelRay(NamedTuple):
    """Pixel, and the vector from the source to the pixel centre.

    Attributes
    ----------
    row, col : int
        Row and column of the pixel.
    x, y, z : float
        Vector from the source to the centre of the pixel, in mm.
    """

    row: int
    col: int
    x: float
    y: float
    z: float


@kernel_helper()
def make_pixel_ray(frame: RayFrame, row: int, col: int) -> PixelRay:
    """Make the ray to a pixel.

    Parameters
    ----------
    frame : RayFrame
        Source and pixels that define the rays.
    row, col : int
        Row and column of the pixel.

    Returns
    -------
    PixelRay
        The pixel and the vector from the source to its centre.
    """
    return PixelRay(
        row,
        col,
        frame.corner_vector.x + col * frame.pixel_mm,
        frame.corner_vector.y,
        frame.corner_vector.z - row * frame.pixel_mm,
    )


@kernel_helper()
def load_facet(triangles: Triangles, triangle: int, facets: Array, k: int) -> None:
    """Copy the edges and the plane of a triangle into a row of `facets`.

    A row of `facets` has four numbers per edge: row and column of the start point, and changes of row and column along
    the edge. The last four numbers are the plane.

    Parameters
    ----------
    triangles : Triangles
        Triangles of the surface.
    triangle : int
        Number of the triangle.
    facets : (n, 16) float64 array, mm and px
        Edges in pixels, and planes in mm; row `k` is overwritten.
    k : int
        Row of `facets` to fill.
    """
    for corner in range(3):
        one, other = triangles.faces[triangle, corner], triangles.faces[triangle, (corner + 1) % 3]
        for axis in range(2):
            start = triangles.projected[one, axis]
            facets[k, 4 * corner + axis] = start
            facets[k, 4 * corner + 2 + axis] = triangles.projected[other, axis] - start
    for part in range(4):
        facets[k, 12 + part] = triangles.planes[triangle, part]


@kernel_helper()
def hit_depth(pixel_ray: PixelRay, facets: Array, k: int, min_depth: float) -> float:
    """Compute the depth at which a ray meets a triangle.

    Parameters
    ----------
    pixel_ray : PixelRay
        Ray to a pixel.
    facets : (n, 16) float64 array, mm and px
        Edges and planes of triangles, from `load_facet`.
    k : int
        Row of `facets` with the triangle.
    min_depth : float
        Lower limit of the depth; only a deeper hit is accepted.

    Returns
    -------
    float
        Depth as a fraction of the source-to-pixel distance. The returned depth is 0 if the hit is not deeper than
        `min_depth`, or the pixel is not strictly inside the projected triangle.
    """
    scaled = facets[k, 15]  # Positive if the ray meets the triangle from behind and leaves the surface.
    at = scaled / (facets[k, 12] * pixel_ray.x + facets[k, 13] * pixel_ray.y + facets[k, 14] * pixel_ray.z)
    if not at > min_depth:
        return 0.0
    for e in range(0, 12, 4):
        turn = facets[k, e + 3] * (pixel_ray.row - facets[k, e]) - (pixel_ray.col - facets[k, e + 1]) * facets[k, e + 2]
        if not turn * scaled > 0.0:
            return 0.0
    return at


@kernel_helper()
def _load_point(vectors: Floats, k: int) -> Point:
    """Read row k of float32 vectors (n, 3) as a float64 point."""
    return Point(np.float64(vectors[k, 0]), np.float64(vectors[k, 1]), np.float64(vectors[k, 2]))


@kernel_helper()
def _point_at_depth(frame: RayFrame, centre: Point, pixel_ray: PixelRay, depth: float) -> Point:
    """Compute the point at a specified depth along a ray, relative to the centre of a surface."""
    x, y, z = frame.source.x - centre.x, frame.source.y - centre.y, frame.source.z - centre.z
    return Point(x + depth * pixel_ray.x, y + depth * pixel_ray.y, z + depth * pixel_ray.z)


@kernel()
def advance_rays(
    hits: tuple[Ints, Floats],
    triangles: Triangles,
    frame: RayFrame,
    extent: Extent,
    crossings: Crossings,
    progress: CastProgress,
    rays: Rays,
) -> int:
    """Record the hits, remove finished or unreliable rays, and restart the other rays.

    Parameters
    ----------
    hits : tuple of (n,) int32 array and (n,) float32 array, mm
        Number of the triangle that each ray hit, negative for no hit, and the distance to the hit.
    triangles : Triangles
        Triangles of the surface.
    frame : RayFrame
        Source and pixels that define the rays.
    extent : Extent
        Centre and depth range of the surface.
    crossings : Crossings
        Crossings of the window; filled in place.
    progress : CastProgress
        State of the pixels; updated in place.
    rays : Rays
        Rays that were cast. Continuing rays are moved to the start of each array.

    Returns
    -------
    int
        Number of continuing rays.
    """
    window = crossings.window
    count, facet, left, doubt = 0, np.empty((1, 16)), progress.remaining, progress.suspect
    for k in range(len(hits[0])):
        pixel, triangle = rays.pixels[k], hits[0][k]
        if triangle < 0:
            continue
        row = pixel // window.cols
        spot = make_pixel_ray(frame, window.row + row, window.col + pixel - row * window.cols)
        if triangle == rays.triangles[k] and left[pixel] > 1:
            # Due to rounding, the restart point is in front of the triangle that was just hit. The ray restarts from
            # the distance that Embree reports.
            at, tries = rays.depths[k], rays.repeat_hits[k] + 1
            start, off, far = _load_point(rays.origins, k), _load_point(rays.directions, k), hits[1][k]
            place = Point(start.x + far * off.x, start.y + far * off.y, start.z + far * off.z)
        else:
            load_facet(triangles, triangle, facet, 0)
            at, tries = hit_depth(spot, facet, 0, rays.depths[k]), 0
            n, sign = crossings.starts[pixel + 1] - left[pixel], 1 if facet[0, 15] > 0.0 else -1
            crossings.depth[n], crossings.sign[n], progress.hit_triangles[n] = at, sign, triangle
            left[pixel] -= 1
            progress.sign_sum[pixel] += sign
            doubt[pixel] = at == 0.0
            x, y, z = facet[0, 12], facet[0, 13], facet[0, 14]
            turn = sign / math.sqrt(x * x + y * y + z * z)
            off, place = Point(x * turn, y * turn, z * turn), _point_at_depth(frame, extent.centre, spot, at)
        doubt[pixel] = doubt[pixel] or tries >= REPEAT_HIT_LIMIT
        if doubt[pixel] or left[pixel] == 0:
            continue
        step, turn = RESTART_EPSILONS * FLOAT32_EPSILON * max(abs(place.x), abs(place.y), abs(place.z)), 1.0
        if left[pixel] == 1:
            place, step, turn = _point_at_depth(frame, extent.centre, spot, extent.far), 0.0, -1.0
        rays.origins[count, 0], rays.directions[count, 0] = place.x + step * off.x, turn * rays.directions[k, 0]
        rays.origins[count, 1], rays.directions[count, 1] = place.y + step * off.y, turn * rays.directions[k, 1]
        rays.origins[count, 2], rays.directions[count, 2] = place.z + step * off.z, turn * rays.directions[k, 2]
        rays.pixels[count], rays.depths[count] = pixel, at
        rays.triangles[count], rays.repeat_hits[count] = triangle, tries
        count += 1
    return count
