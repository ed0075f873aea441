"""MeanBone: the mean man's femur or tibia, as a field and as solids settled on it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import FemurShape, RoughZone, TibiaShape
from ..data.records import encoded
from ..data.shapes import ShapeTable
from ..data.store import Arrays, Origin, kept, ship
from ..geometry.freeform import displaced, with_displacements
from ..geometry.mesh import Indices, Mesh
from .implicit import Field, lengths, project_to_surface
from .remesh import mesh_bone
from .roughness import in_zones
from .shape import BoneForm, knee_form
from .solids import checked, mesh_of, solid_of, split_where

# What its solids are made by, beside its tables.
SOURCES = (
    *(f"anatomy/{name}.py" for name in ("femur", "implicit", "mean_bone", "noise", "remesh", "roughness", "shape")),
    *("anatomy/solids.py", "anatomy/tibia.py", "geometry/freeform.py", "geometry/mesh.py"),
)
_LIBRARIES = ("manifold3d", "numpy", "scipy")
# Places are whole numbers of this: as near as nobody needs it, small on the disk, and the same on machines that round
# in other ways.
_GRID_MM = 2.0**-20
# Inner surfaces, whose edge trabeculae blur, are drawn with fewer triangles, within this.
_INNER_MM = 0.03
# Depths to which vertices of the outer surface are followed inwards, past the thickest cortex; steps from one to the
# next; and turns in which a place and the thickness there agree.
_DEPTHS_MM = (0.0, 0.5, 1.0, 1.75, 2.75, 4.0, 5.5, 7.5)
_STEPS, _TURNS, _SETTLED_MM = 4, 12, 0.005
# Edges whose middles most people's forms would move off them by more are split, up to so many times.
_BENT_MM, _SPLITS, _FAR_SD = 0.05, 5, 2.0
# Longest edge where a bone is rough: a quarter of the shortest wave.
_ROUGH_MM = 2.0


OfBone = TypeVar("OfBone", FemurShape, TibiaShape)
Shell = Callable[[Array, float, float | Array], Array]
Uneven = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Plates:
    """Subchondral plates of a bone, over the mean man's; they pass into each other over middle_mm."""

    medial: float
    lateral: float
    middle_mm: float

    def at(self, points: Array) -> Array:
        """(n,)  at points (n, 3) in the bone's frame, mm"""
        x = points[:, 0]
        return self.lateral + (self.medial - self.lateral) * (1 + x / np.hypot(x, self.middle_mm)) / 2


@dataclass(frozen=True, eq=False, kw_only=True)
class MeanBone:
    """A bone with a straight shaft, at the mean man's size, in its own frame.

    field         approximate distance from its outer surface, mm, negative inside; points (n, 3) -> (n,)
    shell         how thick its cortex or plate is at places: points (n, 3), relative cortex, relative plate, of all or
                  (n,) -> (n,) mm
    rough         gives the same shape by CSG, with hard creases
    edge_mm       longest edge of its triangles, away from the shaft
    tolerance_mm  how far middles of edges may be off the field
    form          how people's bones of this kind are formed, for which its triangles are small enough
    zones         where it is rough, likewise
    tables        all that it is made from, as bytes
    """

    name: str
    field: Field
    shell: Shell
    rough: Callable[[], Manifold]
    edge_mm: float
    tolerance_mm: float
    form: BoneForm
    zones: tuple[RoughZone, ...]
    tables: bytes

    @property
    def outer(self) -> Manifold:
        """Its outer solid."""
        return self._parts[0]

    def depth_mm(self, cortex: float, plates: Plates, uneven: Uneven | None = None) -> Array:
        """(n,)  how thick its cortex and plate are on the ways inwards of `inner`

        cortex  thickness over the mean man's
        plates  likewise
        uneven  from places (n, 3) of the outer surface and thickness there (n,): what that is multiplied by (n,)
        """
        _, _, ways = self._parts
        plate = plates.at(ways[0])
        depth = self.shell(ways[0], cortex, plate)
        share = np.ones(len(depth)) if uneven is None else uneven(ways[0], depth)
        depth *= share
        # The shell's thickness is that at its inner side, which lies where the thickness says; halfway, so that thick
        # plates with steep ends settle too.
        unsettled = np.arange(len(depth))
        for _ in range(_TURNS):
            there = self.shell(_along(ways[:, unsettled], depth[unsettled]), cortex, plate[unsettled])
            step = (share[unsettled] * there - depth[unsettled]) / 2
            depth[unsettled] += step
            unsettled = unsettled[np.abs(step) > _SETTLED_MM]
        return depth

    def inner(self, depth_mm: Array) -> Mesh:
        """What its cortex and plate leave of it: vertices of a coarser outer surface on their ways inwards.

        depth_mm  (n,)
        """
        _, faces, ways = self._parts
        return Mesh(_along(ways, depth_mm), faces)

    def prepare(self) -> None:
        """Make its solids now, or read them, where that is still to be done."""
        _ = self._parts

    def meshed(self, tolerance_mm: float) -> Manifold:
        """Its outer solid within another tolerance; made anew at every call."""
        return checked(mesh_bone(self.rough(), self.field, self.edge_mm, (tolerance_mm,))[0], self.name)

    @property
    def origin(self) -> Origin:
        """What its solids are kept under."""
        return Origin(sources=SOURCES, libraries=_LIBRARIES, facts=self.tables)

    def ship(self) -> None:
        """Make its solids and put them into the package, so that nobody waits for them."""
        ship(self.name, self.origin, self.made())

    @cached_property
    def _parts(self) -> tuple[Manifold, Indices, Array]:
        """Its outer solid; faces (m, 3) of a coarser surface, and (depths, n, 3) ways inwards of its vertices."""
        arrays = kept(self.name, self.origin, self.made)
        ways = np.cumsum(arrays["steps"], axis=0) * _GRID_MM
        return solid_of(arrays["points"] * _GRID_MM, arrays["faces"], self.name), arrays["inner_faces"], ways

    def made(self) -> Arrays:
        """Its solids, made now: int32, places in `_GRID_MM`, of ways inwards the steps from one depth to the next."""
        solids = mesh_bone(self.rough(), self.field, self.edge_mm, (self.tolerance_mm, _INNER_MM))
        outer, coarser = (mesh_of(flexible(checked(solid, self.name), self.form, self.zones)) for solid in solids)
        ways = [coarser.vertices]
        for depth in _DEPTHS_MM[1:]:
            ways.append(project_to_surface(ways[-1], self.field, partial(_everywhere, depth), _STEPS))
        steps = np.diff(_on_grid(np.array(ways)), axis=0, prepend=0)
        places = {"points": _on_grid(outer.vertices), "steps": steps}
        faces = {"faces": outer.faces, "inner_faces": coarser.faces}
        return {name: values.astype(np.int32) for name, values in (places | faces).items()}


def mean_bone(
    name: str,
    shape: OfBone,
    field: Field,
    shell: Callable[[OfBone, Array, float, float | Array], Array],
    rough: Callable[[OfBone], Manifold],
    forms: ShapeTable,
) -> MeanBone:
    """The mean man's bone of a shape; shell and rough as in MeanBone, of that shape.

    forms  that people's bones have, for which its triangles must be small enough
    """
    return MeanBone(
        name=name,
        field=field,
        shell=partial(shell, shape),
        rough=partial(rough, shape),
        edge_mm=shape.edge_mm,
        tolerance_mm=shape.tolerance_mm,
        form=knee_form(forms).bones[name],
        zones=shape.rough,
        tables=encoded(shape, getattr(forms.lattices, name), forms.modes),
    )


def _on_grid(places: Array) -> Indices:
    return np.round(places / _GRID_MM).astype(np.int64)


def _everywhere(depth_mm: float, points: Array) -> Array:
    return np.full(len(points), depth_mm)


def _along(ways: Array, depth_mm: Array) -> Array:
    """(n, 3)  places so deep (n,) on ways inwards (depths, n, 3), which are all but straight between two of them"""
    depths = np.array(_DEPTHS_MM)
    level = np.clip(np.searchsorted(depths, depth_mm) - 1, 0, len(depths) - 2)
    share = (depth_mm - depths[level]) / (depths[level + 1] - depths[level])
    each = np.arange(len(depth_mm))
    return ways[level, each] + share[:, None] * (ways[level + 1, each] - ways[level, each])


def flexible(solid: Manifold, form: BoneForm, zones: tuple[RoughZone, ...] = ()) -> Manifold:
    """The same solid with edges short enough to bend as people's forms have it.

    Edges are split whose middles would be more than 0.05 mm off in the mean form and two standard deviations from it,
    and those of over 2 mm where the bone is rough.
    """
    mesh = mesh_of(solid)

    def bent(places: Array, edges: Indices) -> tuple[Indices, Array]:
        middles = places[edges].mean(axis=1)
        off = _sagitta(places, edges, middles, form) > _BENT_MM
        off |= in_zones(middles, zones) & (lengths(np.diff(places[edges], axis=1)[:, 0]) > _ROUGH_MM)
        return edges[off], middles[off]

    return solid_of(*split_where(mesh.vertices, mesh.faces, _SPLITS, bent), "flexible")


def _sagitta(places: Array, edges: Indices, middles: Array, form: BoneForm) -> Array:
    """(n,)  how far the middles of edges (n, 2) are off them in forms two standard deviations from the mean"""

    def bend(displacements_mm: Array) -> Array:
        lattice = with_displacements(form.mean, displacements_mm)
        ends = displaced(places, lattice) - places
        return lengths(displaced(middles, lattice) - middles - ends[edges].mean(axis=1))

    spread = np.sqrt(np.sum([bend(mode) ** 2 for mode in form.modes_mm], axis=0))
    return np.asarray(bend(form.mean.displacements_mm) + _FAR_SD * spread)
