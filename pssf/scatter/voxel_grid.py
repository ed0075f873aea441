"""Conversion of a scene of closed surfaces to a voxel grid of materials, for the Monte Carlo simulation."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_in_range
from ..core.numba_kernel import kernel
from ..geometry.scene import Scene, require_traceable
from ..geometry.view import View
from ..raycast.engines.crossings import Window
from ..raycast.engines.projected_surface import BAND_ROWS, project_surface
from ..raycast.engines.scanline import find_crossings

# Distance from the source to the voxel grid, in mm; rays are then parallel to the voxel columns within 1e-5 voxels.
_SOURCE_DISTANCE_MM = 1e7
# Maximum number of voxels.
_MAX_VOXELS = 30_000_000


class _ColumnCrossings(NamedTuple):
    """Crossings of voxel-column centre lines with a surface: `starts`, `depth` and `sign` as in `Crossings`."""

    starts: NDArray[np.int64]
    depth: Array
    sign: NDArray[np.int8]


@dataclass(frozen=True, kw_only=True)
class Voxels:
    """Materials on a regular grid.

    Attributes
    ----------
    index : (x, y, z) uint8 array
        Index of the voxel material in `names`.
    names : tuple of str
        Names of the materials; the ambient material is first.
    origin_mm : (3,) float64 array
        Lower corner of voxel (0, 0, 0), in mm.
    size_mm : (3,) float64 array
        Size of a voxel, in mm.
    """

    index: NDArray[np.uint8]
    names: tuple[str, ...]
    origin_mm: Array
    size_mm: Array

    @property
    def upper_mm(self) -> Array:
        """Upper corner (3,) of the grid, in mm."""
        return np.asarray(self.origin_mm + np.array(self.index.shape) * self.size_mm)


def voxelise_scene(scene: Scene, bounds_mm: Array | None = None, *, voxel_mm: float = 2.0) -> Voxels:
    """Find the material at the centre of every voxel of a grid.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials.
    bounds_mm : (2, 3) array, mm, optional
        Lower and upper corner of the volume to voxelise; by default the bounding box of the scene. The grid may exceed
        the volume by up to one voxel in x and z.
    voxel_mm : float, default 2
        Voxel size, from 0.05 to 100 mm. Voxels may be smaller in y, so that the grid ends exactly at the volume
        boundary.

    Returns
    -------
    Voxels
        Materials on the grid.

    Raises
    ------
    InputError
        If the scene cannot be traced, the grid would have more than 30 million voxels, or the scene has more than 255
        materials.

    Notes
    -----
    In each voxel, every material has a count: the number of surrounding surfaces with the material inside, minus the
    number with the material outside. The voxel material is the material with the largest count. The voxel grid
    therefore agrees with the path lengths of `raycast.trace`. The density of every material is constant.
    """
    require_traceable(scene)
    require_in_range("voxel_mm", voxel_mm, 0.05, 100, "mm")
    low, high = np.asarray(scene.bounds_mm if bounds_mm is None else bounds_mm, np.float64)
    number = np.maximum(np.ceil((high - low) / voxel_mm - 1e-9), 1).astype(int)
    if np.prod(number.astype(float)) > _MAX_VOXELS:
        least = math.ceil(10 * float(np.prod(high - low) / _MAX_VOXELS) ** (1 / 3)) / 10
        raise InputError(f"voxel_mm must be {least:g} mm or more for a volume of this size, got {voxel_mm:g} mm")
    if len(scene.materials) > 255:
        raise InputError(f"scene must have 255 or fewer materials, got {len(scene.materials)}")
    size = np.array([voxel_mm, (high[1] - low[1]) / number[1], voxel_mm])
    origin = (low + high) / 2 - number * size / 2
    upside = _fill_voxels(scene, origin, size, number)
    return Voxels(
        index=np.ascontiguousarray(upside[::-1].transpose(1, 2, 0)),
        names=scene.materials,
        origin_mm=origin,
        size_mm=size,
    )


def _fill_voxels(scene: Scene, origin: Array, size: Array, number: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Compute the material numbers (rows, x, y); row 0 has the largest z."""
    high = origin + number * size
    view = View(
        source_mm=((origin[0] + high[0]) / 2, origin[1] - _SOURCE_DISTANCE_MM, (origin[2] + high[2]) / 2),
        centre_mm=((origin[0] + high[0]) / 2, high[1], (origin[2] + high[2]) / 2),
        rows=int(number[2]),
        cols=int(number[0]),
        pixel_mm=float(size[0]),
    )
    names = scene.materials
    sheets = [project_surface(surface.solid, view) for surface in scene.surfaces]
    # Factor that converts a depth fraction of the source-to-detector distance to a position in the voxel column, in
    # voxels.
    scale = (_SOURCE_DISTANCE_MM + number[1] * size[1]) / size[1]
    index = np.empty((number[2], number[0], number[1]), np.uint8)
    for first in range(0, view.rows, BAND_ROWS):
        stop = min(first + BAND_ROWS, view.rows)
        counts = np.zeros((len(names), stop - first, number[0], number[1]), np.int8)
        counts[0] = 1
        for sheet, surface in zip(sheets, scene.surfaces, strict=True):
            top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
            if top < bottom and surface.inside != surface.outside:
                crossed = find_crossings(sheet, top, bottom)
                window = crossed.window._replace(row=top - first)
                inside, outside = (counts[names.index(name)] for name in (surface.inside, surface.outside))
                _count_surfaces(
                    _ColumnCrossings(crossed.starts, crossed.depth, crossed.sign),
                    window,
                    scale,
                    number[1],
                    inside,
                    outside,
                )
        index[first:stop] = counts.argmax(axis=0)
    return index


@kernel()
def _count_surfaces(
    crossed: _ColumnCrossings,
    window: Window,
    scale: float,
    voxels: int,
    inside: NDArray[np.int8],
    outside: NDArray[np.int8],
) -> None:
    """Add 1 to `inside` (rows, x, y), and subtract 1 from `outside`, for voxels whose centre is inside a surface."""
    starts, depth, sign = crossed
    for pixel in range(len(starts) - 1):
        row, col = window.row + pixel // window.cols, window.col + pixel % window.cols
        for k in range(starts[pixel], starts[pixel + 1]):
            # The counts of every voxel with its centre behind the crossing change by +1 on entry and by -1 on exit.
            first = max(math.ceil(voxels - 0.5 - (1.0 - depth[k]) * scale), 0)
            for y in range(first, voxels):
                inside[row, col, y] -= sign[k]
                outside[row, col, y] += sign[k]
