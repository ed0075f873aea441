"""Embree engine: cast rays from hit to hit, recompute each hit in float64, and correct unreliable rays.

Embree uses float32 and finds only the next triangle that a ray hits. This module computes the depth of the hit in
float64, from the plane of the triangle. It also computes the number of crossings of each ray in float64, from the
outlines of the projected triangles.

Three rules reduce the number of casts. First, a ray without crossings is not cast, and a ray stops when all its
crossings are found. Second, a ray may reuse the triangles of a neighbouring pixel, or triangles adjacent to them. This
requires that the ray lies strictly inside exactly as many triangles as it has crossings. Third, the last crossing is
cast backwards from behind the surface, because Embree is faster for rays that start outside.

The scanline engine recomputes a pixel in four cases:

- In float64, the pixel is not strictly inside the projected triangle. The ray passes so near an edge that Embree may
  return the adjacent triangle, or the two triangles.
- A hit is not deeper than the previous hit, or the same triangle is hit too often. The two cases occur where the
  surface is seen edge-on.
- Embree finds fewer triangles than the ray has crossings. This happens at an outline, or between surfaces that nearly
  touch.
- The sum of the crossing signs is not the winding number of the surface around the source.

After this correction, every crossing is real, none is duplicated and none is missing.
"""

import os
from functools import cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from ...core.checks import Array
from ...geometry.mesh_topology import drop_unused_vertices
from ..path_lengths import Audit
from . import scanline
from .crossings import (
    Crossings,
    Window,
    allocate_crossings,
    chord_fractions,
)
from .neighbour_reuse import (
    GRID,
    NeighbourTriangles,
    find_adjacent_faces,
    reuse_from_grid,
    reuse_from_neighbours,
)
from .pixel_rays import ray_vectors_mm
from .projected_surface import Point, ProjectedSurface, Triangles
from .ray_state import (
    CastProgress,
    Extent,
    Ints,
    Rays,
    advance_rays,
)

# Maximum number of hits per ray; a ray with more hits is recomputed. Real meshes have far fewer crossings per ray.
HIT_LIMIT = 20_000
# All surfaces of a process share one Embree device, because Embree crashes at about a thousand devices. The cache key
# is the process id, so a forked process makes its own device.
_make_device = cache(lambda process: EmbreeDevice())


class Caster:
    """Ray caster for one surface.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    around : int
        Winding number of the surface around the source.
    """

    def __init__(self, sheet: ProjectedSurface, around: int) -> None:
        self.sheet, self.source_winding = sheet, around
        # Adding a triangle to Embree takes a microsecond and blocks other Python threads (global interpreter lock).
        # Therefore, only triangles that a ray can hit are added.
        whole, in_sight = sheet.triangles, np.zeros(len(sheet.triangles.faces), np.bool_)
        in_sight[sheet.order] = True
        kept = np.flatnonzero(in_sight)
        points, faces = drop_unused_vertices(sheet.points, whole.faces[kept])
        if not len(kept):
            points = np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        # Coordinates are relative to the surface centre, because float32 is most precise near zero. Coordinates
        # relative to the focal spot would have an error of 1e-4 mm.
        centre, margin = (low + high) / 2, 0.01 * (high - low).max()
        near, far = (np.array([low[1] - margin, high[1] + margin]) - sheet.frame.source.y) / sheet.frame.corner_vector.y
        self.extent = Extent(Point(*centre.tolist()), max(float(near), 0.0), float(far))
        planes, rows = whole.planes[kept], whole.rows[kept]
        self.triangles = Triangles(whole.faces[kept], whole.projected, planes, whole.near[kept], whole.far[kept], rows)
        self.adjacent_faces = find_adjacent_faces(self.triangles.faces, len(whole.projected))
        # The robust mode of Embree takes 20 % more time and is not needed: a missed hit changes the number of
        # crossings, and the scanline engine then recomputes the ray.
        self.tree = EmbreeScene(_make_device(os.getpid()), robust=False)
        # The embreex package converts each number separately, which is three times as fast for Python objects.
        corners = np.fromiter(zip(*faces.T.tolist(), strict=True), object, len(faces))
        TriangleMesh(self.tree, (points - centre).astype(np.float32).astype(object), corners)
        # The first call of run() builds the search tree of Embree. The call is made here, because two threads must not
        # build the tree at the same time.
        self.tree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), output=1)

    def trace_chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """Compute the chords inside the surface for the rays to a range of rows.

        Parameters
        ----------
        first, stop : int
            Half-open range of rows within one band of `BAND_ROWS` rows.

        Returns
        -------
        chords : (rows, cols) float64 array
            Lengths inside the surface, as fractions of the source-to-pixel distance.
        audit : Audit
            Counts of cast rays and of rays that the scanline engine recomputed.
        """
        listed, audit = self.find_crossings(first, stop)
        return chord_fractions(listed), audit

    def find_crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """Find the crossings of rays with the surface, for a range of rows.

        Parameters
        ----------
        first, stop : int
            Half-open range of rows within one band of `BAND_ROWS` rows.

        Returns
        -------
        crossings : Crossings
            Crossings of all rays, in order along each ray.
        audit : Audit
            Counts of cast rays and of rays that the scanline engine recomputed.
        """
        number = scanline.count_crossings(self.sheet, first, stop)
        listed = allocate_crossings(Window(first, self.sheet.cols[0], *number.shape), number)
        turns, doubt = np.zeros(number.size, np.int32), np.zeros(number.size, np.bool_)
        progress = CastProgress(number.reshape(-1).copy(), turns, doubt, np.empty(len(listed.depth), np.int32))
        on_grid = np.zeros(number.shape, np.bool_)
        on_grid[::GRID, ::GRID] = True
        self._cast_rays(on_grid.reshape(-1), listed, progress)
        most = int(number.max(initial=0))
        reuse_from_grid(self.triangles, self.sheet.frame, listed, progress, most)
        near = NeighbourTriangles(
            self.triangles, self.adjacent_faces, np.full(most, -1, np.int32), np.empty((most, 16))
        )
        for way in (+1, -1):
            reuse_from_neighbours(near, self.sheet.frame, listed, progress, way)
        self._cast_rays(~on_grid.reshape(-1), listed, progress)
        bad = (progress.remaining > 0) | (turns != self.source_winding) | doubt
        rays = int(np.count_nonzero(number))
        return listed, self._repair_pixels(listed, bad, doubt, rays) if bad.any() else Audit(rays=rays)

    def _repair_pixels(self, listed: Crossings, bad: NDArray[np.bool_], doubt: NDArray[np.bool_], rays: int) -> Audit:
        """Recompute the crossings of unreliable pixels in place with the scanline engine; return the ray counts.

        `bad` and `doubt` have shape (rows x cols,).
        """
        scanline.recompute_crossings(self.sheet, listed, bad)
        number = np.diff(listed.starts)
        pixels = np.repeat(np.arange(len(number)), number)
        wrong = np.bincount(pixels, listed.sign, len(number)) != self.source_winding
        wrong |= np.bincount(pixels, ~np.isfinite(listed.depth), len(number)) > 0
        count, imprecise, unrepaired = (int(np.count_nonzero(which)) for which in (bad, doubt, wrong & bad))
        return Audit(
            rays=rays,
            unbalanced=count - imprecise,
            imprecise=imprecise,
            repaired=count - unrepaired,
            unrepaired=unrepaired,
        )

    def _cast_rays(self, among: NDArray[np.bool_], listed: Crossings, progress: CastProgress) -> None:
        """Cast rays for the pixels marked in `among` (rows x cols,) whose crossings are not all found."""
        pixels = np.flatnonzero((progress.remaining > 0) & among)
        rays, count = self._start_rays(listed.window, pixels, progress.remaining[pixels]), len(pixels)
        for _ in range(HIT_LIMIT):
            if count == 0:
                break
            hit = self.tree.run(rays.origins[:count], rays.directions[:count], output=1)
            hits = hit["primID"], hit["tfar"]
            count = advance_rays(hits, self.triangles, self.sheet.frame, self.extent, listed, progress, rays)
        progress.suspect[rays.pixels[:count]] = True

    def _start_rays(self, window: Window, pixels: NDArray[np.int64], left: Ints) -> Rays:
        """Make rays to pixels (n,) of a window, starting in front of the surface.

        A ray with only one remaining crossing starts behind the surface and runs backwards.
        """
        frame, (centre, near, far) = self.sheet.frame, self.extent
        x, y, z = ray_vectors_mm(frame, window.row + pixels // window.cols, window.col + pixels % window.cols)
        length = np.sqrt(x * x + y * y + z * z)
        at, turn = np.where(left == 1, far, near), np.where(left == 1, -1.0, 1.0) / length
        origins, directions = np.empty((len(pixels), 3), np.float32), np.empty((len(pixels), 3), np.float32)
        for axis, way in enumerate((x, np.full_like(x, y), z)):
            origins[:, axis] = frame.source[axis] - centre[axis] + at * way
            directions[:, axis] = turn * way
        depths, again = np.zeros(len(pixels)), np.zeros(len(pixels), np.int32)
        return Rays(origins, directions, pixels.astype(np.int32), depths, np.full_like(again, -1), again)
