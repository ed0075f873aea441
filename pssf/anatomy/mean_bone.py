"""MeanBone: the mean man's femur or tibia, as a field and as solids settled on it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ..core.checks import Array
from ..data.store import Arrays, Origin, kept
from ..geometry.freeform import displaced, with_displacements
from ..geometry.mesh import Indices
from .implicit import Field, lengths
from .remesh import mesh_bone
from .shape import BoneForm
from .solids import checked, edges_of, mesh_of, solid_of, split_edges

_ORIGIN = Origin(sources=("core", "data", "geometry", "anatomy"), libraries=("manifold3d", "numpy", "scipy", "trimesh"))
# Inner surfaces, whose edge trabeculae blur, are drawn with fewer triangles, within this.
INNER_MM = 0.03
# Edges whose middles most people's forms would move off them by more are split, up to so many times.
_BENT_MM, _SPLITS, _FAR_SD = 0.05, 5, 2.0


@dataclass(frozen=True, eq=False)
class MeanBone:
    """A bone with a straight shaft, at the mean man's size, in its own frame.

    field         approximate distance from its outer surface, mm, negative inside; points (n, 3) -> (n,)
    rough         gives the same shape by CSG, with hard creases
    edge_mm       longest edge of its triangles, away from the shaft
    tolerance_mm  how far middles of edges may be off the field
    form          how people's bones of this kind are formed, for which its triangles are small enough
    """

    name: str
    field: Field
    rough: Callable[[], Manifold]
    edge_mm: float
    tolerance_mm: float
    form: BoneForm

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
        arrays: dict[str, NDArray[Any]] = {}
        for which, solid in zip(("outer", "coarser"), solids, strict=True):
            mesh = mesh_of(flexible(checked(solid, self.name), self.form))
            arrays |= {f"{which}_points": mesh.vertices, f"{which}_faces": mesh.faces}
        return arrays


def flexible(solid: Manifold, form: BoneForm) -> Manifold:
    """The same solid with edges short enough to bend as people's forms have it.

    Edges are split whose middles would be more than 0.05 mm off in the mean form and two standard deviations from it.
    """
    mesh = mesh_of(solid)
    places, faces = mesh.vertices, mesh.faces
    for _ in range(_SPLITS):
        edges = edges_of(faces)
        middles = places[edges].mean(axis=1)
        off = _sagitta(places, edges, middles, form) > _BENT_MM
        if not off.any():
            break
        faces = split_edges(faces, edges[off], len(places))
        places = np.vstack((places, middles[off]))
    return solid_of(places, faces, "flexible")


def _sagitta(places: Array, edges: Indices, middles: Array, form: BoneForm) -> Array:
    """(n,)  how far the middles of edges (n, 2) are off them in forms two standard deviations from the mean"""

    def bend(displacements_mm: Array) -> Array:
        lattice = with_displacements(form.mean, displacements_mm)
        ends = displaced(places, lattice) - places
        return lengths(displaced(middles, lattice) - middles - ends[edges].mean(axis=1))

    spread = np.sqrt(np.sum([bend(mode) ** 2 for mode in form.modes_mm], axis=0))
    return np.asarray(bend(form.mean.displacements_mm) + _FAR_SD * spread)
