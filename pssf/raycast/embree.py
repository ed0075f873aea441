"""Embree engine: rays are cast hit by hit, every hit is computed again in float64, and what is in doubt is repaired.

Embree works in float32. Its answer is taken only for which triangle comes next; where the ray meets the plane of that
triangle is computed in float64. How many crossings a ray has is counted beforehand in float64, from the outlines of the
projected triangles; a ray without any is not cast, one that has them all asks no further, and one that lies inside as
many triangles of a neighbour's, or of those across their edges, has met these. The last crossing is looked for from
behind: a ray that starts outside finds its triangle sooner than one that starts within. A pixel is handed to the
scanline engine if

- it does not lie strictly inside the projected triangle, in float64: the ray passes so near an edge that Embree took
  the neighbour, or both;
- a hit lies no deeper than the one before it, or the same triangle is met too often: a surface seen edge-on;
- Embree finds no more triangles before the count is reached: at an outline, or between sheets that nearly touch;
- the signs of its crossings do not add up to how often the surface goes around the source.

So every crossing taken is a true one, no two are the same, and there are as many as there should be.
"""

import os
from functools import cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.topology import used
from . import scanline
from .casting import Extent, Ints, Progress, Rays, advance
from .crossings import Crossings, Window, chords, room_for
from .paths import Audit
from .rays import ways_mm
from .sheets import Point, Sheet, Triangles
from .spread import GRID, Near, across_edges, spread, walk_on

# A ray with more crossings than any mesh has is given up and repaired.
HIT_LIMIT = 20_000
# For all surfaces: with one each, Embree crashes at a thousand of them. A forked process makes its own.
_device = cache(lambda process: EmbreeDevice())


class Caster:
    """Casts the rays of a window that cross a surface.

    around  how often the surface goes around the source
    """

    def __init__(self, sheet: Sheet, around: int) -> None:
        self.sheet, self.around = sheet, around
        # Embree takes in a microsecond a triangle, under Python's lock: it gets those that a ray can meet.
        whole, in_sight = sheet.triangles, np.zeros(len(sheet.triangles.faces), np.bool_)
        in_sight[sheet.order] = True
        kept = np.flatnonzero(in_sight)
        points, faces = used(sheet.points, whole.faces[kept])
        if not len(kept):
            points = np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        # Around the surface's own centre float32 is finest; from the focus it would err by 1e-4 mm.
        centre, margin = (low + high) / 2, 0.01 * (high - low).max()
        near, far = (np.array([low[1] - margin, high[1] + margin]) - sheet.frame.source.y) / sheet.frame.way.y
        self.extent = Extent(Point(*centre.tolist()), max(float(near), 0.0), float(far))
        planes, rows = whole.planes[kept], whole.rows[kept]
        self.triangles = Triangles(whole.faces[kept], whole.projected, planes, whole.near[kept], whole.far[kept], rows)
        self.across = across_edges(self.triangles.faces, len(whole.projected))
        # Not "robust", which takes a fifth more time: what Embree misses is noticed by the count, and repaired.
        self.tree = EmbreeScene(_device(os.getpid()), robust=False)
        # embreex reads number by number, as Python does: from Python's own numbers and tuples in a third of the time.
        corners = np.fromiter(zip(*faces.T.tolist(), strict=True), object, len(faces))
        TriangleMesh(self.tree, (points - centre).astype(np.float32).astype(object), corners)
        # The first call builds the tree; it must not be two threads' first call.
        self.tree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), output=1)

    def chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """What `scanline.chords` gives, and an audit."""
        listed, audit = self.crossings(first, stop)
        return chords(listed), audit

    def crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """What `scanline.crossings` gives, and an audit."""
        number = scanline.counts(self.sheet, first, stop)
        listed = room_for(Window(first, self.sheet.cols[0], *number.shape), number)
        turns, doubt = np.zeros(number.size, np.int32), np.zeros(number.size, np.bool_)
        progress = Progress(number.reshape(-1).copy(), turns, doubt, np.empty(len(listed.depth), np.int32))
        on_grid = np.zeros(number.shape, np.bool_)
        on_grid[::GRID, ::GRID] = True
        self._cast(on_grid.reshape(-1), listed, progress)
        most = int(number.max(initial=0))
        spread(self.triangles, self.sheet.frame, listed, progress, most)
        near = Near(self.triangles, self.across, np.full(most, -1, np.int32), np.empty((most, 16)))
        for way in (+1, -1):
            walk_on(near, self.sheet.frame, listed, progress, way)
        self._cast(~on_grid.reshape(-1), listed, progress)
        bad = (progress.left > 0) | (turns != self.around) | doubt
        rays = int(np.count_nonzero(number))
        return listed, self._repaired(listed, bad, doubt, rays) if bad.any() else Audit(rays=rays)

    def _repaired(self, listed: Crossings, bad: NDArray[np.bool_], doubt: NDArray[np.bool_], rays: int) -> Audit:
        """Take the crossings of bad pixels from the scanline engine, in place; returns the audit."""
        scanline.refill(self.sheet, listed, bad)
        number = np.diff(listed.starts)
        pixels = np.repeat(np.arange(len(number)), number)
        wrong = np.bincount(pixels, listed.sign, len(number)) != self.around
        wrong |= np.bincount(pixels, ~np.isfinite(listed.depth), len(number)) > 0
        count, imprecise, unrepaired = (int(np.count_nonzero(which)) for which in (bad, doubt, wrong & bad))
        return Audit(
            rays=rays,
            unbalanced=count - imprecise,
            imprecise=imprecise,
            repaired=count - unrepaired,
            unrepaired=unrepaired,
        )

    def _cast(self, among: NDArray[np.bool_], listed: Crossings, progress: Progress) -> None:
        """Cast the rays of those pixels, out of some, that have crossings left."""
        pixels = np.flatnonzero((progress.left > 0) & among)
        rays, count = self._start(listed.window, pixels, progress.left[pixels]), len(pixels)
        for _ in range(HIT_LIMIT):
            if count == 0:
                break
            hit = self.tree.run(rays.origins[:count], rays.directions[:count], output=1)
            hits = hit["primID"], hit["tfar"]
            count = advance(hits, self.triangles, self.sheet.frame, self.extent, listed, progress, rays)
        progress.doubt[rays.pixels[:count]] = True

    def _start(self, window: Window, pixels: NDArray[np.int64], left: Ints) -> Rays:
        """Rays to pixels of a window, from before the surface; those of a single crossing from behind it."""
        frame, (centre, near, far) = self.sheet.frame, self.extent
        x, y, z = ways_mm(frame, window.row + pixels // window.cols, window.col + pixels % window.cols)
        length = np.sqrt(x * x + y * y + z * z)
        at, turn = np.where(left == 1, far, near), np.where(left == 1, -1.0, 1.0) / length
        origins, directions = np.empty((len(pixels), 3), np.float32), np.empty((len(pixels), 3), np.float32)
        for axis, way in enumerate((x, np.full_like(x, y), z)):
            origins[:, axis] = frame.source[axis] - centre[axis] + at * way
            directions[:, axis] = turn * way
        depths, again = np.zeros(len(pixels)), np.zeros(len(pixels), np.int32)
        return Rays(origins, directions, pixels.astype(np.int32), depths, np.full_like(again, -1), again)
