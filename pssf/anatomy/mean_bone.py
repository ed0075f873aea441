"""MeanBone: the mean man's femur or tibia, as a field and as solids settled on it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from manifold3d import Manifold

from ..data.store import Arrays, Origin, kept
from .implicit import Field
from .remesh import mesh_bone
from .solids import checked, solid_of

_ORIGIN = Origin(sources=("core", "data", "anatomy"), libraries=("manifold3d", "numpy", "scipy", "trimesh"))
# Inner surfaces, whose edge trabeculae blur, are drawn with fewer triangles, within this.
INNER_MM = 0.03


@dataclass(frozen=True, eq=False)
class MeanBone:
    """A bone with a straight shaft, at the mean man's size, in its own frame.

    field         approximate distance from its outer surface, mm, negative inside; points (n, 3) -> (n,)
    rough         gives the same shape by CSG, with hard creases
    edge_mm       longest edge of its triangles, away from the shaft
    tolerance_mm  how far middles of edges may be off the field
    """

    name: str
    field: Field
    rough: Callable[[], Manifold]
    edge_mm: float
    tolerance_mm: float

    @property
    def outer(self) -> Manifold:
        """Its outer solid."""
        return self._solids[0]

    @property
    def coarser(self) -> Manifold:
        """Its outer solid with the fewer triangles of an inner surface."""
        return self._solids[1]

    def prepare(self) -> None:
        """Make its solids now, or read them, where that is still to be done."""
        _ = self._solids

    def meshed(self, tolerance_mm: float) -> Manifold:
        """Its outer solid within another tolerance; made anew at every call."""
        return checked(mesh_bone(self.rough(), self.field, self.edge_mm, (tolerance_mm,))[0], self.name)

    @cached_property
    def _solids(self) -> tuple[Manifold, Manifold]:
        arrays = kept(self.name, _ORIGIN, self._made)
        outer, coarser = (
            solid_of(arrays[f"{which}_points"], arrays[f"{which}_faces"], self.name) for which in ("outer", "coarser")
        )
        return outer, coarser

    def _made(self) -> Arrays:
        solids = mesh_bone(self.rough(), self.field, self.edge_mm, (self.tolerance_mm, INNER_MM))
        arrays = {}
        for which, solid in zip(("outer", "coarser"), solids, strict=True):
            mesh = checked(solid, self.name).to_mesh64()
            arrays[f"{which}_points"] = np.array(mesh.vert_properties[:, :3])
            arrays[f"{which}_faces"] = np.array(mesh.tri_verts)
        return arrays
