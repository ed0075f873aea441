"""Embree engine: rays are cast hit by hit, every hit is computed again in float64, and what is in doubt is repaired.

Embree works in float32. Its answer is taken only for which triangle comes next; where the ray meets the plane of that
triangle is computed in float64. How many crossings a ray has is counted beforehand in float64, from the outlines of the
projected triangles; a ray without any is not cast, one that has them all asks no further, and one that lies inside as
many triangles of a neighbour's has met those. The last crossing is looked for from behind: a ray that starts outside
finds its triangle sooner than one that starts within. A pixel is handed to the scanline engine if

- it does not lie strictly inside the projected triangle, in float64: the ray passes so near an edge that Embree took
  the neighbour, or both;
- a hit lies no deeper than the one before it, or the same triangle is found too often: a surface seen edge-on;
- Embree finds no more triangles before the count is reached: at an outline, or between sheets that nearly touch;
- the signs of its crossings do not add up to how often the surface goes around the source.

So every crossing taken is a true one, no two are the same, and there are as many as there should be.
"""

import math
import os
from functools import cache
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numba import njit
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.topology import used
from . import scanline
from .crossings import Crossings, chords, offsets
from .paths import Audit
from .rays import start
from .sheets import Sheet

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]
Signs = NDArray[np.int8]

SPACING = float(np.finfo(np.float32).eps)

# A ray starts again this many float32 spacings off the triangle it met, on its far side. Off the triangle, not along
# the ray: one met at a grazing angle would be found again. This is past the rounding of both, and short of any other
# sheet that matters: two sheets of one surface within 4e-5 mm (at 100 mm from its centre) are skipped together.
STEP_SPACINGS = 3.0

# Of so many columns one is cast first. A ray between two of them that lies strictly inside as many of a neighbour's
# triangles as it has crossings has met those, and is not cast itself.
STRIDE = 4

# A triangle found again and again, or a ray with more crossings than any mesh has, is given up and repaired.
AGAIN_LIMIT = 8
HIT_LIMIT = 20_000
# For all surfaces: with one each, Embree crashes at a thousand of them. A forked process makes its own.
_device = cache(lambda process: EmbreeDevice())


class Caster:
    """Casts the rays of a window that cross a surface.

    around  how often the surface goes around the source
    """

    def __init__(self, sheet: Sheet, around: int) -> None:
        self.sheet, self.around = sheet, around
        # Embree takes in half a microsecond a triangle, under Python's lock: it gets those that a ray can meet.
        kept = scanline.covering(sheet)
        points, faces = used(sheet.points, sheet.faces[kept])
        if not len(kept):
            points = np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        size = float((high - low).max())
        self.low, self.high = low - 0.01 * size, high + 0.01 * size
        # Around the surface's own centre float32 is finest; from the focus it would err by 1e-4 mm.
        self.centre = (low + high) / 2
        self.geometry = (sheet.faces[kept], sheet.seen, sheet.planes[kept], sheet.frame, self.centre)
        # Not "robust", which takes a fifth more time: what Embree misses is noticed by the count, and repaired.
        self.tree = EmbreeScene(_device(os.getpid()), robust=False)
        TriangleMesh(self.tree, (points - self.centre).astype(np.float32), faces)
        # The first call builds the tree; it must not be two threads' first call.
        self.tree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), output=1)

    def chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """What `scanline.chords` gives, and an audit."""
        found, audit = self.crossings(first, stop)
        return chords(found), audit

    def crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """What `scanline.crossings` gives, and an audit."""
        sheet = self.sheet
        number = scanline.counts(sheet, first, stop)
        window = (first, sheet.cols[0], *number.shape)
        left, starts = number.reshape(-1).copy(), offsets(number)
        depth, sign, doubt = np.zeros(starts[-1]), np.zeros(starts[-1], np.int8), np.zeros(number.size, np.bool_)
        rays = _Rays(int(np.count_nonzero(left)))
        pixels, met = np.array(window), np.empty(starts[-1], np.int32)
        place: tuple[Any, ...] = (sheet.frame, self.centre, self.low, self.high, pixels, left, doubt, *rays.state)
        state: tuple[Any, ...] = (*self.geometry, pixels, starts, depth, sign, met, doubt, left, *rays.state)
        for between in (False, True):
            count: int = start(*place, STRIDE, between)  # type: ignore[call-arg]
            for _ in range(HIT_LIMIT):
                if count == 0:
                    break
                hit = self.tree.run(rays.origins[:count], rays.directions[:count], output=1)
                count = _advance(hit["primID"], hit["tfar"], *state)
            doubt[rays.pixels[:count]] = True
            if not between:
                _spread(*self.geometry[:4], pixels, starts, depth, sign, met, doubt, left, STRIDE)
        found = Crossings(window=window, starts=starts, depth=depth, sign=sign)
        lacking = _lacking(starts, sign, left, self.around) & ~doubt
        unrepaired = self._repair(found, (doubt | lacking).reshape(number.shape))
        audit = Audit(
            rays=len(rays.pixels),
            unbalanced=int(lacking.sum()),
            imprecise=int(doubt.sum()),
            repaired=int((doubt | lacking).sum()) - unrepaired,
            unrepaired=unrepaired,
        )
        return found, audit

    def _repair(self, found: Crossings, bad: NDArray[np.bool_]) -> int:
        """Take the crossings of bad pixels from the scanline engine, in place; returns how many are bad even then."""
        first, _, _, cols = found.window
        unrepaired = 0
        for row in map(int, np.flatnonzero(bad.any(axis=1))):
            exact = scanline.crossings(self.sheet, first + row, first + row + 1)
            for col in map(int, np.flatnonzero(bad[row])):
                place = slice(*found.starts[row * cols + col : row * cols + col + 2])
                source = slice(*exact.starts[col : col + 2])
                found.depth[place], found.sign[place] = exact.depth[source], exact.sign[source]
                balanced = found.sign[place].sum() == self.around and np.isfinite(found.depth[place]).all()
                unrepaired += not balanced
        return unrepaired


class _Rays:
    """Rays under way, packed: the first `count` entries of each array are alive."""

    def __init__(self, size: int) -> None:
        self.origins = np.empty((size, 3), np.float32)  # around the surface's centre
        self.directions = np.empty((size, 3), np.float32)  # of length 1
        self.pixels = np.empty(size, np.int32)  # within the window
        self.depths = np.empty(size)  # of the last hit from the front
        self.ends = np.empty(size)  # depth behind the surface, from where the last crossing is looked for
        self.triangles = np.empty(size, np.int32)  # of the last hit
        self.again = np.empty(size, np.int32)  # times that it was found again
        self.state: tuple[Any, ...] = (
            self.origins,
            self.directions,
            self.pixels,
            self.depths,
            self.ends,
            self.triangles,
            self.again,
        )


@njit(cache=True, nogil=True)
def _lacking(starts: NDArray[np.int64], sign: Signs, left: Ints, around: int) -> NDArray[np.bool_]:
    """Which rays have crossings left to find, or signs that do not add up."""
    lacking = left > 0
    for pixel in range(len(left)):
        total = 0
        for k in range(starts[pixel], starts[pixel + 1]):
            total += sign[k]
        if total != around:
            lacking[pixel] = True
    return lacking


@njit(cache=True, nogil=True, inline="always")
def _place(frame: Array, centre: Array, at: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Where a ray is at a depth, around the centre of a surface."""
    return frame[0] - centre[0] + at * x, frame[1] - centre[1] + at * y, frame[2] - centre[2] + at * z


@njit(cache=True, nogil=True, inline="always")
def _way(frame: Array, window: NDArray[np.int64], pixel: int) -> tuple[int, int, float, float, float]:
    """Row and column of a pixel of a window, and the way of its ray from the source to it."""
    row, col = window[0] + pixel // window[3], window[1] + pixel % window[3]
    return row, col, frame[3] + col * frame[6], frame[4], frame[5] - row * frame[6]


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
def _spread(
    faces: Ints,
    seen: Array,
    planes: Array,
    frame: Array,
    window: NDArray[np.int64],
    starts: NDArray[np.int64],
    depth: Array,
    sign: Signs,
    met: Ints,
    doubt: NDArray[np.bool_],
    left: Ints,
    stride: int,
) -> None:
    """Give pixels the triangles of a neighbour that was cast, where they lie strictly inside every one of them."""
    for pixel in range(len(left)):
        off, cols = pixel % window[3] % stride, window[3] - pixel % window[3]
        if left[pixel] == 0 or off == 0:
            continue
        row, col, x, y, z = _way(frame, window, pixel)
        for other in (pixel - off, pixel + stride - off):
            if stride - off >= cols and other > pixel:
                continue
            if left[other] or doubt[other] or starts[other + 1] - starts[other] != left[pixel]:
                continue
            last, holds = 0.0, True
            for k in range(left[pixel]):
                triangle = met[starts[other] + k]
                nx, ny, nz, scaled = planes[triangle]
                at = scaled / (nx * x + ny * y + nz * z)
                holds = at > last and _holds(seen, faces[triangle], scaled, row, col)
                if not holds:
                    break
                last, place = at, starts[pixel] + k
                depth[place], sign[place], met[place] = at, 1 if scaled > 0.0 else -1, triangle
            if holds:
                left[pixel] = 0
                break


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
    starts: NDArray[np.int64],
    depth: Array,
    sign: Signs,
    met: Ints,
    doubt: NDArray[np.bool_],
    left: Ints,
    origins: Floats,
    directions: Floats,
    pixels: Ints,
    depths: Array,
    ends: Array,
    triangles: Ints,
    again: Ints,
) -> int:
    """Note hits, drop rays that are done or in doubt, move the others on; returns their count."""
    count = 0
    for k in range(len(found)):
        pixel, triangle = pixels[k], found[k]
        if triangle < 0:
            continue
        row, col, x, y, z = _way(frame, window, pixel)
        if triangle == triangles[k] and left[pixel] > 1:
            # Rounding put the new start before the triangle just left after all: go on from where Embree sees it.
            at, tries = depths[k], again[k] + 1
            px, py, pz = origins[k] + distance[k] * directions[k]
            ox, oy, oz = directions[k]
        else:
            nx, ny, nz, scaled = planes[triangle]
            at, tries = scaled / (nx * x + ny * y + nz * z), 0
            px, py, pz = _place(frame, centre, at, x, y, z)
            doubt[pixel] = not at > depths[k] or not _holds(seen, faces[triangle], scaled, row, col)
            off = (1.0 if scaled > 0.0 else -1.0) / math.sqrt(nx * nx + ny * ny + nz * nz)
            ox, oy, oz = nx * off, ny * off, nz * off
            place = starts[pixel + 1] - left[pixel]
            depth[place], sign[place], met[place] = at, 1 if scaled > 0.0 else -1, triangle
            left[pixel] -= 1
        if doubt[pixel] or tries >= AGAIN_LIMIT:
            doubt[pixel] = True
            continue
        if left[pixel] == 0:
            continue
        step, turn = STEP_SPACINGS * SPACING * max(abs(px), abs(py), abs(pz)), 1.0
        if left[pixel] == 1:
            px, py, pz = _place(frame, centre, ends[k], x, y, z)
            step, turn = 0.0, -1.0
        origins[count, 0], origins[count, 1], origins[count, 2] = px + step * ox, py + step * oy, pz + step * oz
        for axis in range(3):
            directions[count, axis] = turn * directions[k, axis]
        pixels[count], depths[count], ends[count], triangles[count], again[count] = pixel, at, ends[k], triangle, tries
        count += 1
    return count
