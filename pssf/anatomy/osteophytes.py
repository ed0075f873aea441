"""Osteophytes: lips of the joint margins and spikes elsewhere that flow into the bone, each with a cortex."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..data.bones import Margins
from ..geometry.mesh import Indices, Mesh
from ..model.knee import Osteophyte
from .implicit import Field, blend, project_to_surface
from .lips import Deform, Lip, lip_at
from .mean_bone import MeanBone
from .remesh import laplacian_smooth
from .solids import box_about, mesh_of, solid_of, split_where
from .spikes import Spike, at_margin, in_middle, on_spine

_CORTEX_MM = 0.3
# Large ones have more of it, by this part of their size.
_THICKENING = 0.06
# Rounds of evening out the mesh.
_ROUNDS = 3
_EDGE_MM, _ROUGH_EDGE_MM = 2.0, 1.2
# Of what is inside: places less deep than the first are moved in to there, in so many steps, which leaves tips where
# they are; edges that come nearer to the surface than the second, at these shares of their way, are split, so often; a
# bone that it is cut with is drawn in by the last.
_SHALLOW_MM, _STEPS, _NEAR_MM, _ALONG, _SPLITS, _DRAWN_IN_MM = 0.2, 4, 0.1, (0.25, 0.5, 0.75), 4, 0.3
# At a margin, at the mean man's size, what is less than this is a spike.
_SMALL_MM = 0.38
# Spongy bone that is cut off by surfaces that all but touch, which turns inside out when it is deformed.
_SPECK_MM3 = 1e-2
# Either has its farthest point, a field, a solid, and what is near it.
OsteophyteShape = Lip | Spike


@dataclass(frozen=True, eq=False)
class BoneWithOsteophytes:
    """A bone's outer surface with its osteophytes, in its frame at the mean man's size.

    name    of the bone
    field   approximate distance from the surface, mm; points (n, 3) -> (n,)
    make    gives the surface, without a solid, so that it may be asked for in any thread
    deform  what the bone is deformed by, (n, 3) -> (n, 3) mm
    """

    name: str
    field: Field
    make: Callable[[], Mesh]
    deform: Deform
    shapes: tuple[OsteophyteShape, ...] = ()

    @cached_property
    def mesh(self) -> Mesh:
        """Its surface."""
        return self.make()

    @cached_property
    def outer(self) -> Manifold:
        """The same as a solid."""
        return solid_of(*self.mesh, f"{self.name} with osteophytes")

    @cached_property
    def formed(self) -> Array:
        """(n, 3)  where its vertices are in this person's form, mm"""
        return self.deform(self.mesh.vertices)

    def filled(self, marrow: Mesh, scale: float) -> Mesh:
        """The trabecular surface of the bone with what is inside its osteophytes."""
        if not self.shapes:
            return marrow
        inner = solid_of(*marrow, "marrow")
        for shape in self.shapes:
            within = shape.solid(_CORTEX_MM / scale + _THICKENING * shape.size_mm)
            # With edges short enough to bend with the bone.
            fine = mesh_of(within.refine_to_length(_EDGE_MM))
            drawn_in = self._drawn_in(fine)
            if drawn_in is not None:
                inner = inner + solid_of(*drawn_in, "what is inside an osteophyte")
            else:  # folded: solids, which take longer, do not fold
                inner = inner + _within_bone(within, self.outer, shape.out).refine_to_length(_EDGE_MM)
        return mesh_of(_without_specks(inner))

    def _drawn_in(self, within: Mesh) -> Mesh | None:
        """What is inside an osteophyte, drawn in where it is shallow; None where that folds it.

        A margin may not hold the feet of a small one. Where an edge crosses a crease its ends may be deep and its
        middle not: it is split, and the middle drawn in.
        """
        for _ in range(_SPLITS):
            places = within.vertices.copy()
            shallow = self.field(places) > -_SHALLOW_MM
            places[shallow] = self._as_deep(places[shallow])
            moved = Mesh(places, within.faces)
            if (_normals(within) * _normals(moved)).sum(axis=1).min() <= 0:
                return None
            within = Mesh(*split_where(*moved, 1, self._near))
            if len(within.faces) == len(moved.faces):
                break
        return moved

    def _near(self, places: Array, edges: Indices) -> tuple[Indices, Array]:
        """Of edges (n, 2) those that come too near to the surface, and their middles."""
        # A middle is no nearer to the surface than an end by more than half an edge.
        shallow = self.field(places) > -_EDGE_MM / 2 - _NEAR_MM
        edges = edges[shallow[edges].any(axis=1)]
        ends = places[edges]
        along = [(1 - share) * ends[:, 0] + share * ends[:, 1] for share in _ALONG]
        across = (self.field(np.concatenate(along)).reshape(len(_ALONG), -1) > -_NEAR_MM).any(axis=0)
        return edges[across], ends[across].mean(axis=1)

    def _as_deep(self, points: Array) -> Array:
        return project_to_surface(points, self.field, lambda points: np.full(len(points), _SHALLOW_MM), _STEPS)


def _normals(mesh: Mesh) -> Array:
    one, two, three = mesh.vertices[mesh.faces.T]
    return np.cross(two - one, three - one)


def _within_bone(within: Manifold, bone: Manifold, out: Array) -> Manifold:
    """What of a solid is in a bone drawn in."""
    about = bone ^ box_about(within, 2 * _DRAWN_IN_MM)
    within = within ^ about
    for way in (*np.eye(3), *-np.eye(3), -out):
        # One after the other: of two copies of the bone the surfaces cross everywhere.
        within.status()
        within = within ^ about.translate(_DRAWN_IN_MM * way)
    return within


def _without_specks(solid: Manifold) -> Manifold:
    bodies = solid.decompose()
    return Manifold.compose([body for body in bodies if body.volume() > _SPECK_MM3]) if len(bodies) > 1 else solid


def grow(
    osteophytes: tuple[Osteophyte, ...], mean: MeanBone, margins: Margins, scale: float, deform: Deform
) -> BoneWithOsteophytes:
    """A bone with the osteophytes that belong to it.

    margins  where they are, and their form
    scale    of the knee, whose osteophytes are as large as they say
    deform   what the bone is deformed by afterwards, (n, 3) -> (n, 3), whose stretching is taken back here
    raises   InputError where one hides the farthest point of another
    """
    own = [osteophyte for osteophyte in osteophytes if osteophyte.bone == mean.name]
    shapes = [_shape(osteophyte, osteophyte.size_mm / scale, mean, margins, deform) for osteophyte in own]
    if not shapes:
        return BoneWithOsteophytes(mean.name, mean.field, partial(mesh_of, mean.outer), deform)
    _refuse_hidden(osteophytes, shapes, mean.name)

    def whole(points: Array) -> Array:
        bare = mean.field(points)
        joined = bare.copy()
        for shape in shapes:
            close = shape.near(points)
            # Each is blended with the bone alone: blended with each other, one would lift the tip of its neighbour.
            with_it = blend(bare[close], shape.field(points[close]), shape.fillet_mm)
            joined[close] = np.minimum(joined[close], with_it)
        return joined

    def near(points: Array) -> NDArray[np.bool_]:
        return np.asarray(np.any([shape.near(points) for shape in shapes], axis=0))

    rough = mean.outer
    for shape in shapes:
        rough = rough + shape.solid(0.0).refine_to_length(_ROUGH_EDGE_MM)
    farthest = [shape.farthest for shape in shapes]
    make = partial(laplacian_smooth, mesh_of(rough), whole, _ROUNDS, near, farthest)
    return BoneWithOsteophytes(mean.name, whole, make, deform, tuple(shapes))


def _shape(osteophyte: Osteophyte, size_mm: float, mean: MeanBone, margins: Margins, deform: Deform) -> OsteophyteShape:
    side, where = osteophyte.site.split("_")
    direction = 1.0 if side == "medial" else -1.0
    if where == "spine":
        return on_spine(direction, mean.outer, size_mm, deform)
    if osteophyte.central:
        return in_middle(margins.central, (direction, osteophyte.place), mean, size_mm, deform)
    margin = margins.femur if mean.name == "femur" else margins.tibia
    # What is too small for a lip, whose profile would be thinner than triangles are long, is a spike.
    if size_mm < _SMALL_MM and osteophyte.place == 0:
        return at_margin(margin, direction, mean.outer, size_mm, deform)
    return lip_at(osteophyte, size_mm, mean, (margin, margins.lip), deform)


def _refuse_hidden(osteophytes: tuple[Osteophyte, ...], shapes: list[OsteophyteShape], bone: str) -> None:
    for shape in shapes:
        for other in shapes:
            if other is not shape and float(other.field(shape.farthest[None])[0]) < 0:
                names = ", ".join(f"{one.site} {one.size_mm:g} mm at {one.place:g}" for one in osteophytes)
                raise InputError(
                    f"osteophytes of the {bone} ({names}): one hides the farthest point of another; allowed: smaller "
                    "ones, or places farther apart"
                )
