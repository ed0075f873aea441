"""Voxels: a scene of closed surfaces as a grid of materials, for photons that do not travel from source to pixel."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require
from ..core.compiled import kernel
from ..geometry.scene import Scene, require_traceable
from ..geometry.view import View
from ..raycast.crossings import Window
from ..raycast.scanline import crossings
from ..raycast.sheets import BAND_ROWS, sheet_of

# So far away that columns of voxels are parallel to 1e-5 of a voxel.
_FAR_MM = 1e7
_MOST_VOXELS = 30_000_000


class _Crossed(NamedTuple):
    """Crossings of columns of voxels with a surface: where each column's start, depth and sign, as in `Crossings`."""

    starts: NDArray[np.int64]
    depth: Array
    sign: NDArray[np.int8]


@dataclass(frozen=True, kw_only=True)
class Voxels:
    """Materials on a regular grid.

    index      (x, y, z) uint8  number of a voxel's material in `names`
    names      materials; the scene's ambient one first
    origin_mm  (3,)  lower corner of voxel (0, 0, 0)
    size_mm    (3,)  of a voxel
    """

    index: NDArray[np.uint8]
    names: tuple[str, ...]
    origin_mm: Array
    size_mm: Array

    @property
    def upper_mm(self) -> Array:
        """(3,)  upper corner of the grid"""
        return np.asarray(self.origin_mm + np.array(self.index.shape) * self.size_mm)


def voxels_of(scene: Scene, bounds_mm: Array | None = None, *, voxel_mm: float = 2.0) -> Voxels:
    """The material at the centre of every voxel of a box.

    A voxel counts, in every material, the surfaces it is within that have it inside less those that have it outside, as
    `raycast.trace` counts path lengths; what is left is its material. A density that varies within a surface
    is taken as its material's own.
    bounds_mm  (2, 3)  the box; by default that around the scene. In x and z the grid reaches beyond it by up to a voxel
    voxel_mm   size; in y it may be less, so that the box ends with a voxel
    raises     InputError for a scene that cannot be traced, more than 30 million voxels or more than 255 materials
    """
    require_traceable(scene)
    require("voxel_mm", voxel_mm, 0.05, 100, "mm")
    low, high = np.asarray(scene.bounds_mm if bounds_mm is None else bounds_mm, np.float64)
    number = np.maximum(np.ceil((high - low) / voxel_mm - 1e-9), 1).astype(int)
    if np.prod(number.astype(float)) > _MOST_VOXELS:
        least = math.ceil(10 * float(np.prod(high - low) / _MOST_VOXELS) ** (1 / 3)) / 10
        raise InputError(f"voxel_mm = {voxel_mm:g} mm; allowed: {least:g} mm or more for a box of this size")
    if len(scene.materials) > 255:
        raise InputError(f"scene: {len(scene.materials)} materials; allowed: 255 or fewer")
    size = np.array([voxel_mm, (high[1] - low[1]) / number[1], voxel_mm])
    origin = (low + high) / 2 - number * size / 2
    upside = _filled(scene, origin, size, number)
    return Voxels(
        index=np.ascontiguousarray(upside[::-1].transpose(1, 2, 0)),
        names=scene.materials,
        origin_mm=origin,
        size_mm=size,
    )


def _filled(scene: Scene, origin: Array, size: Array, number: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(rows, x, y)  materials, row 0 uppermost in z"""
    high = origin + number * size
    view = View(
        source_mm=((origin[0] + high[0]) / 2, origin[1] - _FAR_MM, (origin[2] + high[2]) / 2),
        centre_mm=((origin[0] + high[0]) / 2, high[1], (origin[2] + high[2]) / 2),
        rows=int(number[2]),
        cols=int(number[0]),
        pixel_mm=float(size[0]),
    )
    names = scene.materials
    sheets = [sheet_of(surface.solid, view) for surface in scene.surfaces]
    # From a fraction of the way from the source to the place in the column, in voxels; centres are whole numbers.
    scale = (_FAR_MM + number[1] * size[1]) / size[1]
    index = np.empty((number[2], number[0], number[1]), np.uint8)
    for first in range(0, view.rows, BAND_ROWS):
        stop = min(first + BAND_ROWS, view.rows)
        counts = np.zeros((len(names), stop - first, number[0], number[1]), np.int8)
        counts[0] = 1
        for sheet, surface in zip(sheets, scene.surfaces, strict=True):
            top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
            if top < bottom and surface.inside != surface.outside:
                crossed = crossings(sheet, top, bottom)
                window = crossed.window._replace(row=top - first)
                inside, outside = (counts[names.index(name)] for name in (surface.inside, surface.outside))
                _count(_Crossed(crossed.starts, crossed.depth, crossed.sign), window, scale, number[1], inside, outside)
        index[first:stop] = counts.argmax(axis=0)
    return index


@kernel()
def _count(
    crossed: _Crossed,
    window: Window,
    scale: float,
    voxels: int,
    inside: NDArray[np.int8],
    outside: NDArray[np.int8],
) -> None:
    """Add one to `inside` (rows, x, y) and take one from `outside` where a voxel's centre is within a surface."""
    starts, depth, sign = crossed
    for pixel in range(len(starts) - 1):
        row, col = window.row + pixel // window.cols, window.col + pixel % window.cols
        for k in range(starts[pixel], starts[pixel + 1]):
            # All centres behind a crossing: one more when it enters, one less when it leaves.
            first = max(math.ceil(voxels - 0.5 - (1.0 - depth[k]) * scale), 0)
            for y in range(first, voxels):
                inside[row, col, y] -= sign[k]
                outside[row, col, y] += sign[k]
