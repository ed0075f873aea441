"""Embree engine: cast rays from hit to hit, recompute each hit in float64, and repair doubtful rays.

Embree works in float32. It only decides which triangle comes next. The depth at which the ray meets the plane of that
triangle is computed in float64. The number of crossings of each ray is known in float64 from the outlines of the
projected triangles.

Three rules save work. A ray without crossings is not cast, and a ray stops when it has all of them. A ray takes over
the triangles of a neighbouring pixel, or adjacent ones, if it lies strictly inside as many as it has crossings. The
last crossing is cast from behind the surface, because rays that start outside find their triangle sooner.

A pixel is repaired by the scanline engine in four cases:

- The ray does not lie strictly inside the projected triangle, in float64. It passes so near an edge that Embree may
  return the adjacent triangle, or both.
- A hit is no deeper than the one before it, or the same triangle is hit too often: the surface is seen edge-on.
- Embree finds no more triangles before the number of crossings is reached: at an outline, or between surfaces that
  nearly touch.
- The signs of the crossings do not add up to the number of times that the surface encloses the source.

So each crossing is a true one, no two are the same, and their number is right.
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

# Number of hits per ray beyond which a ray is repaired; no mesh has as many crossings.
HIT_LIMIT = 20_000
# One device serves all surfaces of a process, because Embree crashes at about a thousand devices. A forked process has
# another process id and makes its own.
_make_device = cache(lambda process: EmbreeDevice())


class Caster:
    """Caster of the rays that cross one surface.

    Parameters
    ----------
    sheet : ProjectedSurface
        Projection of the surface.
    around : int
        Number of times that the surface encloses the source.
    """

    def __init__(self, sheet: ProjectedSurface, around: int) -> None:
        self.sheet, self.source_winding = sheet, around
        # Embree needs a microsecond per triangle, under Python's global lock. It gets only triangles that a ray can
        # hit.
        whole, in_sight = sheet.triangles, np.zeros(len(sheet.triangles.faces), np.bool_)
        in_sight[sheet.order] = True
        kept = np.flatnonzero(in_sight)
        points, faces = drop_unused_vertices(sheet.points, whole.faces[kept])
        if not len(kept):
            points = np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        # Coordinates are relative to the centre of the surface, where float32 is finest. Relative to the focal spot,
        # the error would be 1e-4 mm.
        centre, margin = (low + high) / 2, 0.01 * (high - low).max()
        near, far = (np.array([low[1] - margin, high[1] + margin]) - sheet.frame.source.y) / sheet.frame.corner_vector.y
        self.extent = Extent(Point(*centre.tolist()), max(float(near), 0.0), float(far))
        planes, rows = whole.planes[kept], whole.rows[kept]
        self.triangles = Triangles(whole.faces[kept], whole.projected, planes, whole.near[kept], whole.far[kept], rows)
        self.adjacent_faces = find_adjacent_faces(self.triangles.faces, len(whole.projected))
        # The robust mode of Embree takes a fifth more time. It is not needed: missed hits show in the count and are
        # repaired.
        self.tree = EmbreeScene(_make_device(os.getpid()), robust=False)
        # The embreex package converts each number on its own. Python objects take a third of the time of numpy arrays.
        corners = np.fromiter(zip(*faces.T.tolist(), strict=True), object, len(faces))
        TriangleMesh(self.tree, (points - centre).astype(np.float32).astype(object), corners)
        # The first call builds the tree of Embree. It is made here, because two threads must not make it at once.
        self.tree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), output=1)

    def trace_chords(self, first: int, stop: int) -> tuple[Array, Audit]:
        """Compute the chords inside the surface for a range of rows.

        Parameters
        ----------
        first, stop : int
            Half-open range of rows, inside one band.

        Returns
        -------
        chords : (rows, cols) float64 array
            Lengths inside, as fractions of the way from the source to the pixel.
        audit : Audit
            Counts of the rays that were cast and repaired.
        """
        listed, audit = self.find_crossings(first, stop)
        return chord_fractions(listed), audit

    def find_crossings(self, first: int, stop: int) -> tuple[Crossings, Audit]:
        """Find the crossings with the surface for a range of rows.

        Parameters
        ----------
        first, stop : int
            Half-open range of rows, inside one band.

        Returns
        -------
        crossings : Crossings
            Crossings of all rays, in order along each ray.
        audit : Audit
            Counts of the rays that were cast and repaired.
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
        """Recompute the crossings of bad pixels with the scanline engine, in place, and return the audit.

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
        """Cast the rays with crossings left, among the pixels marked in `among` (rows x cols,)."""
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
        """Make rays to pixels (n,) of a window that start before the surface.

        Rays with a single crossing left start behind the surface and run backwards.
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
