"""Osteophyte growth: blend marginal and spike osteophytes into a bone, each with its own cortex."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ...core.checks import Array, InputError
from ...data.anatomy.bone_tables import OsteophyteShapes
from ...geometry.mesh import Indices, Mesh
from ...model.knee import Osteophyte
from ..meshing.implicit_shapes import ScalarField, project_to_surface, smooth_union
from ..meshing.remesh import laplacian_smooth
from ..meshing.solids import (
    build_bounding_box,
    build_solid,
    extract_mesh,
    split_selected_edges,
)
from ..template.template_bone import TemplateBone
from .central_and_spine_osteophytes import (
    SpikeOsteophyte,
    build_central_spike,
    build_margin_spike,
    build_spine_spike,
)
from .marginal_osteophytes import Deformation, LipOsteophyte, build_lip_osteophyte

# Smallest thickness of the cortex of an osteophyte, mm.
_CORTEX_MM = 0.3
# Additional cortical thickness per size of the osteophyte, dimensionless.
_CORTEX_PER_SIZE = 0.06
# Number of smoothing iterations of the mesh around osteophytes.
_SMOOTHING_ROUNDS = 3
# Largest edge length of the mesh of an osteophyte interior, in mm.
_EDGE_MM = 2.0
# Largest edge length of the outer osteophyte mesh before smoothing, in mm.
_ROUGH_EDGE_MM = 1.2
# Smallest depth of vertices of an osteophyte interior below the bone surface, in mm. Shallower vertices are moved to
# this depth.
_SHALLOW_MM = 0.2
# Number of Newton iterations that move shallow interior vertices inwards. Vertices at the tips are deep enough and stay
# in place.
_STEPS = 4
# Smallest distance of an edge of an osteophyte interior from the bone surface, in mm. Closer edges are split.
_NEAR_MM = 0.1
# Positions along an edge at which its depth below the bone surface is tested, as fractions of the edge length.
_ALONG = (0.25, 0.5, 0.75)
# Largest number of times that the edges of a mesh are split.
_SPLITS = 4
# Distance by which the bone surface is moved inwards before an osteophyte interior is intersected with the bone, mm.
_DRAWN_IN_MM = 0.3
# Size below which a marginal osteophyte becomes a spike, in mm at template size.
_MAX_SPIKE_SIZE_MM = 0.38
# Largest volume of a detached component of trabecular bone that is removed, in mm3. Deformation would invert such a
# small component.
_SPECK_MM3 = 1e-2
# Marginal or spike osteophyte. Both classes provide a farthest point, a distance field, a solid and a test for points
# near the osteophyte.
OsteophyteShape = LipOsteophyte | SpikeOsteophyte


@dataclass(frozen=True, eq=False)
class BoneWithOsteophytes:
    """Outer surface of a bone with its osteophytes, in the frame of the bone at template size.

    Attributes
    ----------
    name : str
        Name of the bone.
    field : callable
        Function that maps points (n, 3), in mm, to their approximate signed distances (n,) from the surface, in mm,
        negative inside.
    make_mesh : callable
        Function that makes the surface mesh. It creates no solid, so any thread may call it.
    deform : callable
        Deformation of the bone. It maps points (n, 3), in mm, to points (n, 3), in mm.
    shapes : tuple of LipOsteophyte or SpikeOsteophyte
        Osteophytes of the bone.
    """

    name: str
    field: ScalarField
    make_mesh: Callable[[], Mesh]
    deform: Deformation
    shapes: tuple[OsteophyteShape, ...] = ()

    @cached_property
    def mesh(self) -> Mesh:
        """Surface mesh at template size, in mm."""
        return self.make_mesh()

    @cached_property
    def outer(self) -> Manifold:
        """Solid bounded by the surface mesh, at template size, in mm."""
        return build_solid(*self.mesh, f"{self.name} with osteophytes")

    @cached_property
    def deformed_vertices_mm(self) -> Array:
        """Deformed vertices of the mesh (n, 3), at template size, in mm."""
        return self.deform(self.mesh.vertices)

    def build_trabecular_mesh(self, marrow: Mesh, scale: float) -> Mesh:
        """Add the interior of the osteophytes to the trabecular surface of the bone.

        Parameters
        ----------
        marrow : Mesh
            Trabecular surface of the bone without osteophytes, at template size.
        scale : float
            Size of the bone relative to the template, dimensionless.

        Returns
        -------
        Mesh
            Trabecular surface with osteophytes, or unchanged `marrow` if the bone has no osteophytes.

        Raises
        ------
        InputError
            If a surface is not a valid solid.
        """
        if not self.shapes:
            return marrow
        inner = build_solid(*marrow, "marrow")
        for shape in self.shapes:
            within = shape.build_solid(_CORTEX_MM / scale + _CORTEX_PER_SIZE * shape.size_mm)
            # The edges must be short enough to follow the deformation of the bone.
            fine = extract_mesh(within.refine_to_length(_EDGE_MM))
            drawn_in = self._inset_mesh(fine)
            if drawn_in is not None:
                inner = inner + build_solid(*drawn_in, "osteophyte interior")
            else:  # The moved mesh would have inverted faces. The slower Boolean operation avoids these faces.
                inner = inner + _intersect_inset_bone(within, self.outer, shape.direction).refine_to_length(_EDGE_MM)
        return extract_mesh(_remove_specks(inner))

    def _inset_mesh(self, within: Mesh) -> Mesh | None:
        """Move shallow vertices of an osteophyte interior inwards, or return None if this move inverts faces.

        The base of a small osteophyte may extend beyond the bone at a margin. An edge across a crease may have deep
        ends and a shallow midpoint. Such an edge is split, and the new vertex is moved inwards too.
        """
        for _ in range(_SPLITS):
            places = within.vertices.copy()
            shallow = self.field(places) > -_SHALLOW_MM
            places[shallow] = self._push_inwards(places[shallow])
            moved = Mesh(places, within.faces)
            if (_compute_face_normals(within) * _compute_face_normals(moved)).sum(axis=1).min() <= 0:
                return None
            within = Mesh(*split_selected_edges(*moved, 1, self._find_shallow_edges))
            if len(within.faces) == len(moved.faces):
                break
        return moved

    def _find_shallow_edges(self, places: Array, edges: Indices) -> tuple[Indices, Array]:
        """Find the edges (n, 2) that are too close to the bone surface, and their midpoints (n, 3), in mm."""
        # A point on an edge is closer to the surface than the nearer end of the edge, but by at most half the edge
        # length.
        shallow = self.field(places) > -_EDGE_MM / 2 - _NEAR_MM
        edges = edges[shallow[edges].any(axis=1)]
        ends = places[edges]
        along = [(1 - share) * ends[:, 0] + share * ends[:, 1] for share in _ALONG]
        across = (self.field(np.concatenate(along)).reshape(len(_ALONG), -1) > -_NEAR_MM).any(axis=0)
        return edges[across], ends[across].mean(axis=1)

    def _push_inwards(self, points: Array) -> Array:
        """Move points (n, 3) to the smallest allowed depth, mm."""
        return project_to_surface(points, self.field, lambda points: np.full(len(points), _SHALLOW_MM), _STEPS)


def _compute_face_normals(mesh: Mesh) -> Array:
    """Compute the normal vectors (m, 3) of all faces without normalising their length."""
    one, two, three = mesh.vertices[mesh.faces.T]
    return np.cross(two - one, three - one)


def _intersect_inset_bone(within: Manifold, bone: Manifold, direction: Array) -> Manifold:
    """Intersect a solid with the bone after moving the surface of the bone inwards."""
    about = bone ^ build_bounding_box(within, 2 * _DRAWN_IN_MM)
    within = within ^ about
    for way in (*np.eye(3), *-np.eye(3), -direction):
        # Surfaces of two shifted bone copies cross at many locations. `status` therefore evaluates each intersection
        # separately, because Manifold may otherwise intersect the copies with each other first.
        within.status()
        within = within ^ about.translate(_DRAWN_IN_MM * way)
    return within


def _remove_specks(solid: Manifold) -> Manifold:
    """Remove small connected components from a solid."""
    bodies = solid.decompose()
    return Manifold.compose([body for body in bodies if body.volume() > _SPECK_MM3]) if len(bodies) > 1 else solid


def grow_osteophytes(
    osteophytes: tuple[Osteophyte, ...],
    template: TemplateBone,
    margins: OsteophyteShapes,
    scale: float,
    deform: Deformation,
) -> BoneWithOsteophytes:
    """Add the osteophytes of a bone to its outer surface.

    Parameters
    ----------
    osteophytes : tuple of Osteophyte
        All osteophytes of the knee; osteophytes of other bones are ignored.
    template : TemplateBone
        Template bone.
    margins : OsteophyteShapes
        Locations and dimensions of osteophytes.
    scale : float
        Size of the bone relative to the template, dimensionless. Osteophyte sizes are actual sizes and do not depend on
        this scale.
    deform : callable
        Deformation that is later applied to the bone. It maps points (n, 3), in mm, to points (n, 3), in mm.
        Osteophytes have the specified sizes after this deformation.

    Returns
    -------
    BoneWithOsteophytes
        Outer surface with osteophytes, at template size.

    Raises
    ------
    InputError
        If one osteophyte hides the farthest point of another osteophyte.
    """
    own = [osteophyte for osteophyte in osteophytes if osteophyte.bone == template.name]
    shapes = [
        _build_osteophyte(osteophyte, osteophyte.size_mm / scale, template, margins, deform) for osteophyte in own
    ]
    if not shapes:
        return BoneWithOsteophytes(template.name, template.field, partial(extract_mesh, template.outer), deform)
    _require_tips_not_hidden(osteophytes, shapes, template.name)

    def whole(points: Array) -> Array:
        bare = template.field(points)
        joined = bare.copy()
        for shape in shapes:
            close = shape.is_near(points)
            # Each osteophyte is blended only with the bone. Blending it with another osteophyte would move its tip.
            with_it = smooth_union(bare[close], shape.compute_distance_mm(points[close]), shape.fillet_mm)
            joined[close] = np.minimum(joined[close], with_it)
        return joined

    def near(points: Array) -> NDArray[np.bool_]:
        return np.asarray(np.any([shape.is_near(points) for shape in shapes], axis=0))

    rough = template.outer
    for shape in shapes:
        rough = rough + shape.build_solid(0.0).refine_to_length(_ROUGH_EDGE_MM)
    farthest = [shape.farthest_point for shape in shapes]
    make = partial(laplacian_smooth, extract_mesh(rough), whole, _SMOOTHING_ROUNDS, near, farthest)
    return BoneWithOsteophytes(template.name, whole, make, deform, tuple(shapes))


def _build_osteophyte(
    osteophyte: Osteophyte, size_mm: float, template: TemplateBone, margins: OsteophyteShapes, deform: Deformation
) -> OsteophyteShape:
    """Build a spine, central or marginal osteophyte, or a small marginal spike, depending on site and size."""
    side, where = osteophyte.site.split("_")
    direction = 1.0 if side == "medial" else -1.0
    if where == "spine":
        return build_spine_spike(direction, template.outer, size_mm, deform)
    if osteophyte.is_central:
        return build_central_spike(margins.central, (direction, osteophyte.place), template, size_mm, deform)
    margin = margins.femur if template.name == "femur" else margins.tibia
    # A very small marginal osteophyte becomes a spike, because its profile would be thinner than the largest edge
    # length of the mesh.
    if size_mm < _MAX_SPIKE_SIZE_MM and osteophyte.place == 0:
        return build_margin_spike(margin, direction, template.outer, size_mm, deform)
    return build_lip_osteophyte(osteophyte, size_mm, template, (margin, margins.lip), deform)


def _require_tips_not_hidden(osteophytes: tuple[Osteophyte, ...], shapes: list[OsteophyteShape], bone: str) -> None:
    """Raise InputError if one osteophyte hides the farthest point of another osteophyte."""
    for shape in shapes:
        for other in shapes:
            if other is not shape and float(other.compute_distance_mm(shape.farthest_point[None])[0]) < 0:
                names = ", ".join(f"{one.site} {one.size_mm:g} mm at {one.place:g}" for one in osteophytes)
                raise InputError(
                    f"osteophytes of the {bone} must not hide the farthest point of another osteophyte, got {names}: "
                    "make them smaller, or place them farther apart"
                )
