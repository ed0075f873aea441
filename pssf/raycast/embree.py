"""Embree engine: rays are cast hit by hit, every hit is computed again in float64, and what is in doubt is repaired.

Embree works in float32. Its answer is taken only for which triangle comes next; where the ray meets the plane of that
triangle is computed in float64. How many crossings a ray has is counted beforehand in float64, from the outlines of the
projected triangles; a ray without any is not cast, and one that has them all asks no further. A pixel is handed to the
scanline engine if

- it does not lie strictly inside the projected triangle, in float64: the ray passes so near an edge that Embree took
  the neighbour, or both;
- a hit lies no deeper than the one before it, or the same triangle is found too often: a surface seen edge-on;
- Embree finds no more triangles before the count is reached: at an outline, or between sheets that nearly touch;
- the signs of its crossings do not add up to zero.

So every crossing taken is a true one, no two are the same, and there are as many as there should be.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numba import njit
from numpy.typing import NDArray

from ..checks import Array
from . import scanline
from .paths import Audit
from .rays import start
from .sheets import Sheet

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

SPACING = float(np.finfo(np.float32).eps)

# A ray starts again this many float32 spacings off the triangle it met, on its far side. Off the triangle, not along
# the ray: one met at a grazing angle would be found again. This is past the rounding of both, and short of any other
# sheet that matters: two sheets of one surface within 4e-5 mm (at 100 mm from its centre) are skipped together.
STEP_SPACINGS = 3.0

# A triangle found again and again, or a ray with more crossings than any mesh has, is given up and repaired.
AGAIN_LIMIT = 8
HIT_LIMIT = 20_000


def caster(sheet: Sheet) -> Callable[[int, int], tuple[Array, Audit]]:
    """A function of the first and the stop row, within one band, giving what `scanline.chords` gives and its audit."""
    low, high = sheet.points.min(axis=0), sheet.points.max(axis=0)
    centre, size = (low + high) / 2, float((high - low).max())
    # Around the surface's own centre float32 is finest; from the focus it would err by 1e-4 mm.
    tree = EmbreeScene(robust=True)
    TriangleMesh(tree, (sheet.points - centre).astype(np.float32), sheet.faces)
    # The first call builds the tree; it must not be two threads' first call.
    tree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), output=1)
    low, high = low - 0.01 * size, high + 0.01 * size

    def cast(first: int, stop: int) -> tuple[Array, Audit]:
        shape = (stop - first, sheet.cols[1] - sheet.cols[0])
        chord, signs, doubt = np.zeros(shape), np.zeros(shape, np.int32), np.zeros(shape, np.bool_)
        left = scanline.crossings(sheet, first, stop).reshape(-1)
        cast_for = int(np.count_nonzero(left))
        window = np.array([first, sheet.cols[0], shape[1]])
        rays = _Rays(cast_for)
        count = start(sheet.frame, centre, low, high, window, left, doubt.reshape(-1), *rays.state)
        for _ in range(HIT_LIMIT):
            if count == 0:
                break
            hit = tree.run(rays.origins[:count], rays.directions[:count], output=1)
            geometry = (sheet.faces, sheet.seen, sheet.planes, sheet.frame, centre)
            sums = (chord.reshape(-1), signs.reshape(-1), doubt.reshape(-1), left)
            count = _advance(hit["primID"], hit["tfar"], *geometry, window, *sums, *rays.state)
        doubt.reshape(-1)[rays.pixels[:count]] = True
        return chord, _repair(sheet, first, chord, doubt, (signs != 0) | (left > 0).reshape(shape), cast_for)

    return cast


class _Rays:
    """Rays under way, packed: the first `count` entries of each array are alive."""

    def __init__(self, size: int) -> None:
        self.origins = np.empty((size, 3), np.float32)  # around the surface's centre
        self.directions = np.empty((size, 3), np.float32)  # of length 1
        self.pixels = np.empty(size, np.int32)  # within the window
        self.depths = np.empty(size)  # of the last hit
        self.triangles = np.empty(size, np.int32)  # of the last hit
        self.again = np.empty(size, np.int32)  # times that it was found again
        self.state: tuple[Any, ...] = (
            self.origins,
            self.directions,
            self.pixels,
            self.depths,
            self.triangles,
            self.again,
        )


def _repair(
    sheet: Sheet, first: int, chord: Array, doubt: NDArray[np.bool_], lacking: NDArray[np.bool_], cast_for: int
) -> Audit:
    """Recompute doubtful and unbalanced pixels of `chord` in place, whole rows at a time."""
    unbalanced = lacking & ~doubt
    bad = unbalanced | doubt
    unrepaired = 0
    for row in map(int, np.flatnonzero(bad.any(axis=1))):
        at = bad[row]
        exact = scanline.chords(sheet, first + row, first + row + 1)[0, at]
        chord[row, at] = exact
        unrepaired += int(((scanline.windings(sheet, first + row)[at] != 0) | ~np.isfinite(exact)).sum())
    return Audit(
        rays=cast_for,
        unbalanced=int(unbalanced.sum()),
        imprecise=int(doubt.sum()),
        repaired=int(bad.sum()) - unrepaired,
        unrepaired=unrepaired,
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _holds(seen: Array, face: Ints, side: float, row: int, col: int) -> bool:
    """Whether a pixel lies strictly inside a projected triangle; side > 0: seen from behind, < 0: from the front."""
    for corner in range(3):
        one, other = face[corner], face[(corner + 1) % 3]
        turn = (seen[other, 1] - seen[one, 1]) * (row - seen[one, 0]) - (col - seen[one, 1]) * (
            seen[other, 0] - seen[one, 0]
        )
        if not turn * side > 0.0:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _advance(
    found: Ints,
    distance: Floats,
    faces: Ints,
    seen: Array,
    planes: Array,
    frame: Array,
    centre: Array,
    window: NDArray[np.int64],
    chord: Array,
    signs: Ints,
    doubt: NDArray[np.bool_],
    left: Ints,
    origins: Floats,
    directions: Floats,
    pixels: Ints,
    depths: Array,
    triangles: Ints,
    again: Ints,
) -> int:
    """Take hits into the sums, drop rays that are done or in doubt, move the others on; returns their count."""
    count = 0
    for k in range(len(found)):
        pixel, triangle = pixels[k], found[k]
        if triangle < 0:
            continue
        row, col = window[0] + pixel // window[2], window[1] + pixel % window[2]
        x, y, z = frame[3] + col * frame[6], frame[4], frame[5] - row * frame[6]
        if triangle == triangles[k]:
            # Rounding put the new start before the triangle just left after all: go on from where Embree sees it.
            at, tries = depths[k], again[k] + 1
            px, py, pz = origins[k] + distance[k] * directions[k]
            ox, oy, oz = directions[k]
        else:
            nx, ny, nz, scaled = planes[triangle]
            at, tries = scaled / (nx * x + ny * y + nz * z), 0
            px, py, pz = frame[0] - centre[0] + at * x, frame[1] - centre[1] + at * y, frame[2] - centre[2] + at * z
            doubt[pixel] = not at > depths[k] or not _holds(seen, faces[triangle], scaled, row, col)
            sign = 1 if scaled > 0.0 else -1
            off = sign / math.sqrt(nx * nx + ny * ny + nz * nz)
            ox, oy, oz = nx * off, ny * off, nz * off
            chord[pixel] += sign * at
            signs[pixel] += sign
            left[pixel] -= 1
        if doubt[pixel] or tries >= AGAIN_LIMIT:
            doubt[pixel] = True
            continue
        if left[pixel] == 0:
            continue
        step = STEP_SPACINGS * SPACING * max(abs(px), abs(py), abs(pz))
        origins[count, 0], origins[count, 1], origins[count, 2] = px + step * ox, py + step * oy, pz + step * oz
        directions[count] = directions[k]
        pixels[count], depths[count], triangles[count], again[count] = pixel, at, triangle, tries
        count += 1
    return count
