"""Rays under way: what is known of them, and how they go on from hit to hit and share what they met."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel
from .crossings import Crossings
from .sheets import Frame, Point, Triangles

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

SPACING = float(np.finfo(np.float32).eps)

# A ray starts again this many float32 spacings off the triangle it met, on its far side. Off the triangle, not along
# the ray: one met at a grazing angle would be found again. This is past the rounding of both, and short of any other
# sheet that matters: two sheets of one surface within 4e-5 mm (at 100 mm from its centre) are skipped together.
STEP_SPACINGS = 3.0

# A triangle met again and again is given up and repaired.
AGAIN_LIMIT = 8


class Rays(NamedTuple):
    """Rays under way, packed: the first entries of each array are alive.

    origins     (n, 3)  around the surface's centre
    directions  (n, 3)  of length 1
    pixels      (n,)    within the window
    depths      (n,)    of the last hit from the front
    triangles   (n,)    of the last hit
    tries       (n,)    times that it was met again
    """

    origins: Floats
    directions: Floats
    pixels: Ints
    depths: Array
    triangles: Ints
    tries: Ints


class Extent(NamedTuple):
    """Where a surface is: its centre, and depths (fractions of the way to the detector) before it and behind it."""

    centre: Point
    near: float
    far: float


class Progress(NamedTuple):
    """How far the pixels of a window have come, (pixels,), and which triangle each crossing is with, (crossings,).

    left   crossings not yet met
    turns  sum of the signs of those that were
    doubt  whether a hit cannot be trusted
    """

    left: Ints
    turns: Ints
    doubt: NDArray[np.bool_]
    met: Ints


class Spot(NamedTuple):
    """A pixel, and the way from the source to it, mm."""

    row: int
    col: int
    x: float
    y: float
    z: float


@callee()
def spot_of(frame: Frame, row: int, col: int) -> Spot:
    """A pixel as a ray's end."""
    return Spot(row, col, frame.way.x + col * frame.pixel_mm, frame.way.y, frame.way.z - row * frame.pixel_mm)


@callee()
def load_facet(triangles: Triangles, triangle: int, facets: Array, k: int) -> None:
    """Put a triangle into row k of facets (n, 16), px and mm: of each edge, row and column of its start and what it
    adds to them; its plane.
    """
    for corner in range(3):
        one, other = triangles.faces[triangle, corner], triangles.faces[triangle, (corner + 1) % 3]
        for axis in range(2):
            start = triangles.projected[one, axis]
            facets[k, 4 * corner + axis] = start
            facets[k, 4 * corner + 2 + axis] = triangles.projected[other, axis] - start
    for part in range(4):
        facets[k, 12 + part] = triangles.planes[triangle, part]


@callee()
def depth_within(spot: Spot, facets: Array, k: int, after: float) -> float:
    """Depth (a share) at which a ray meets triangle k of facets (n, 16), px and mm; 0 unless after a depth and strictly
    inside what is seen of it.
    """
    scaled = facets[k, 15]  # > 0: seen from behind
    at = scaled / (facets[k, 12] * spot.x + facets[k, 13] * spot.y + facets[k, 14] * spot.z)
    if not at > after:
        return 0.0
    for e in range(0, 12, 4):
        turn = facets[k, e + 3] * (spot.row - facets[k, e]) - (spot.col - facets[k, e + 1]) * facets[k, e + 2]
        if not turn * scaled > 0.0:
            return 0.0
    return at


@callee()
def _point(vectors: Floats, k: int) -> Point:
    return Point(np.float64(vectors[k, 0]), np.float64(vectors[k, 1]), np.float64(vectors[k, 2]))


@callee()
def _at(frame: Frame, centre: Point, spot: Spot, depth: float) -> Point:
    """Where a ray is at a depth, around the centre of a surface."""
    x, y, z = frame.source.x - centre.x, frame.source.y - centre.y, frame.source.z - centre.z
    return Point(x + depth * spot.x, y + depth * spot.y, z + depth * spot.z)


@kernel()
def advance(
    hits: tuple[Ints, Floats],
    triangles: Triangles,
    frame: Frame,
    extent: Extent,
    listed: Crossings,
    progress: Progress,
    rays: Rays,
) -> int:
    """Note hits (triangle, distance), drop rays that are done or in doubt, move the others on; returns their count."""
    count, facet, left, doubt = 0, np.empty((1, 16)), progress.left, progress.doubt
    for k in range(len(hits[0])):
        pixel, triangle = rays.pixels[k], hits[0][k]
        if triangle < 0:
            continue
        row = pixel // listed.window.cols
        spot = spot_of(frame, listed.window.row + row, listed.window.col + pixel - row * listed.window.cols)
        if triangle == rays.triangles[k] and left[pixel] > 1:
            # Rounding put the new start before the triangle just left after all: go on from where Embree sees it.
            at, tries = rays.depths[k], rays.tries[k] + 1
            start, off, far = _point(rays.origins, k), _point(rays.directions, k), hits[1][k]
            place = Point(start.x + far * off.x, start.y + far * off.y, start.z + far * off.z)
        else:
            load_facet(triangles, triangle, facet, 0)
            at, tries = depth_within(spot, facet, 0, rays.depths[k]), 0
            n, sign = listed.starts[pixel + 1] - left[pixel], 1 if facet[0, 15] > 0.0 else -1
            listed.depth[n], listed.sign[n], progress.met[n] = at, sign, triangle
            left[pixel], progress.turns[pixel], doubt[pixel] = left[pixel] - 1, progress.turns[pixel] + sign, at == 0.0
            x, y, z = facet[0, 12], facet[0, 13], facet[0, 14]
            turn = sign / math.sqrt(x * x + y * y + z * z)
            off, place = Point(x * turn, y * turn, z * turn), _at(frame, extent.centre, spot, at)
        doubt[pixel] = doubt[pixel] or tries >= AGAIN_LIMIT
        if doubt[pixel] or left[pixel] == 0:
            continue
        step, turn = STEP_SPACINGS * SPACING * max(abs(place.x), abs(place.y), abs(place.z)), 1.0
        if left[pixel] == 1:
            place, step, turn = _at(frame, extent.centre, spot, extent.far), 0.0, -1.0
        rays.origins[count, 0], rays.directions[count, 0] = place.x + step * off.x, turn * rays.directions[k, 0]
        rays.origins[count, 1], rays.directions[count, 1] = place.y + step * off.y, turn * rays.directions[k, 1]
        rays.origins[count, 2], rays.directions[count, 2] = place.z + step * off.z, turn * rays.directions[k, 2]
        rays.pixels[count], rays.depths[count], rays.triangles[count], rays.tries[count] = pixel, at, triangle, tries
        count += 1
    return count
