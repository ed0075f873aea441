"""Template bones: mean femur and tibia as distance fields and as meshed solids."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array
from ...data.anatomy.bone_tables import FemurShape, RoughnessZone, TibiaShape
from ...data.anatomy.shape_table import ShapeModel
from ...data.array_cache import (
    Arrays,
    CacheKey,
    load_or_make_arrays,
    save_to_package,
)
from ...data.table_records import encode_records
from ...geometry.freeform_deformation import displace_points, replace_displacements
from ...geometry.mesh import Indices, Mesh
from ..meshing.implicit_shapes import ScalarField, lengths, project_to_surface
from ..meshing.remesh import mesh_bone
from ..meshing.solids import (
    build_solid,
    extract_mesh,
    require_valid_solid,
    split_selected_edges,
)
from .bone_form import BoneShapeModel, build_shape_model
from .bone_roughness import is_in_zones

# Source files that determine the solids, in addition to the tables. Their contents are part of the cache key.
SOURCES = (
    *(f"anatomy/meshing/{name}.py" for name in ("implicit_shapes", "remesh", "solids", "wave_noise")),
    *(f"anatomy/template/{name}.py" for name in ("bone_form", "bone_roughness", "template_bone")),
    *(f"anatomy/template/{name}.py" for name in ("template_femur", "template_tibia")),
    *("geometry/freeform_deformation.py", "geometry/mesh.py"),
)
# Libraries whose versions are part of the cache key.
_LIBRARIES = ("manifold3d", "numpy", "scipy")
# Grid spacing of stored vertices, in mm. Coordinates are stored as integer multiples of the spacing, which are compact
# and identical on all machines.
_GRID_MM = 2.0**-20
# Meshing tolerance of inner surfaces, mm. It is coarser than the tolerance of outer surfaces, because trabeculae blur
# the inner edge of the cortex.
_INNER_TOLERANCE_MM = 0.03
# Depths at which the inward path of each vertex is stored, in mm. The largest depth exceeds the thickest cortex.
_DEPTHS_MM = (0.0, 0.5, 1.0, 1.75, 2.75, 4.0, 5.5, 7.5)
# Number of Newton iterations from one stored depth to the next.
_STEPS = 4
# Largest number of iterations until the depth equals the shell thickness at this depth.
_TURNS = 12
# Largest change in the last iteration at which depth and shell thickness are regarded as equal, in mm.
_SETTLED_MM = 0.005
# Largest distance by which deformation may move the midpoint of an edge off the edge, in mm. Edges that exceed this
# distance are split.
_BENT_MM = 0.05
# Largest number of times that the edges of a mesh are split.
_SPLITS = 5
# Largest deviation from the mean shape that determines the edge length, in standard deviations.
_FAR_SD = 2.0
# Largest edge length in a roughness zone, in mm: a quarter of the shortest wavelength.
_ROUGH_EDGE_MM = 2.0


BoneShapeT = TypeVar("BoneShapeT", FemurShape, TibiaShape)
# A shell thickness function maps points (n, 3), in mm, relative cortical thickness and relative plate thickness to
# shell thickness (n,), in mm.
ShellThickness = Callable[[Array, float, float | Array], Array]
# A thickness factor function maps points (n, 3), in mm, and thickness (n,), in mm, to local thickness factors (n,),
# dimensionless.
ThicknessFactor = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class SubchondralPlates:
    """Thickness of the medial and the lateral subchondral bone plate relative to the template.

    Parameters
    ----------
    medial : float
        Relative thickness in the medial compartment, dimensionless.
    lateral : float
        Relative thickness in the lateral compartment, dimensionless.
    middle_mm : float
        Width of the transition between the medial and lateral compartment, in mm.
    """

    medial: float
    lateral: float
    middle_mm: float

    def interpolate(self, points: Array) -> Array:
        """Interpolate the relative plate thickness between the medial and lateral compartment.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points in the frame of the bone.

        Returns
        -------
        (n,) float64 array
            Thickness relative to the template, dimensionless.
        """
        x = points[:, 0]
        return self.lateral + (self.medial - self.lateral) * (1 + x / np.hypot(x, self.middle_mm)) / 2


@dataclass(frozen=True, eq=False, kw_only=True)
class TemplateBone:
    """Template femur or tibia with a straight shaft, at template size, in the frame of the bone.

    Attributes
    ----------
    name : str
        Name of the bone.
    field : callable
        Function that maps points (n, 3), in mm, to approximate signed distances (n,) from the outer surface, in mm,
        negative inside.
    shell_thickness_mm : callable
        Function that returns the thickness (n,) of cortex or subchondral bone plate, in mm. Its arguments are points
        (n, 3), in mm, the relative thickness of the cortex, and the relative thickness of the subchondral bone plate
        (number or (n,)).
    build_csg_solid : callable
        Function that builds the same bone as a Boolean combination of solids, with sharp creases.
    edge_mm : float
        Largest edge length of the mesh away from the shaft, in mm.
    tolerance_mm : float
        Largest distance of edge midpoints from the surface of the field, in mm.
    shape_model : BoneShapeModel
        Shape model of the bone. Edges are short enough for its deformations.
    roughness_zones : tuple of RoughnessZone
        Zones with a rough surface. Edges are short enough for their roughness.
    tables : bytes
        All tables that determine the bone, encoded as bytes for the cache key.
    """

    name: str
    field: ScalarField
    shell_thickness_mm: ShellThickness
    build_csg_solid: Callable[[], Manifold]
    edge_mm: float
    tolerance_mm: float
    shape_model: BoneShapeModel
    roughness_zones: tuple[RoughnessZone, ...]
    tables: bytes

    @property
    def outer(self) -> Manifold:
        """Outer solid of the bone, at template size."""
        return self._stored_parts[0]

    def compute_depth_mm(
        self, cortex: float, plates: SubchondralPlates, uneven: ThicknessFactor | None = None
    ) -> Array:
        """Compute the thickness of cortex and subchondral bone plate at each vertex of the coarse surface.

        The thickness is measured along the inward path of the vertex.

        Parameters
        ----------
        cortex : float
            Thickness of the cortex relative to the template, dimensionless.
        plates : SubchondralPlates
            Thickness of the subchondral bone plates relative to the template.
        uneven : callable or None
            Function that maps points (n, 3), in mm, and thickness (n,), in mm, to local thickness factors (n,). None
            means a factor of 1.

        Returns
        -------
        (n,) float64 array
            Thickness at each vertex of the coarse surface, in mm.
        """
        _, _, ways = self._stored_parts
        plate = plates.interpolate(ways[0])
        depth = self.shell_thickness_mm(ways[0], cortex, plate)
        share = np.ones(len(depth)) if uneven is None else uneven(ways[0], depth)
        depth *= share
        # The thickness is defined at the inner surface of the shell, so the depth is iterated until it equals the
        # thickness. Half steps converge even for thick plates with steep ends.
        unsettled = np.arange(len(depth))
        for _ in range(_TURNS):
            there = self.shell_thickness_mm(
                _interpolate_at_depth(ways[:, unsettled], depth[unsettled]), cortex, plate[unsettled]
            )
            step = (share[unsettled] * there - depth[unsettled]) / 2
            depth[unsettled] += step
            unsettled = unsettled[np.abs(step) > _SETTLED_MM]
        return depth

    def build_inner_mesh(self, depth_mm: Array) -> Mesh:
        """Build the inner surface of cortex and subchondral bone plate.

        The coarse outer surface is moved along its inward paths.

        Parameters
        ----------
        depth_mm : (n,) float64 array
            Depth of each vertex, in mm, from `compute_depth_mm`.

        Returns
        -------
        Mesh
            Inner surface at template size.
        """
        _, faces, ways = self._stored_parts
        return Mesh(_interpolate_at_depth(ways, depth_mm), faces)

    def prepare(self) -> None:
        """Build the solids or read them from the cache, unless they are already in memory."""
        _ = self._stored_parts

    def mesh_to_tolerance(self, tolerance_mm: float) -> Manifold:
        """Mesh the outer solid with another tolerance, bypassing the cache.

        Parameters
        ----------
        tolerance_mm : float
            Largest distance of edge midpoints from the surface of the field, in mm.

        Returns
        -------
        Manifold
            Outer solid.

        Raises
        ------
        InputError
            If the mesh is not a valid solid.
        """
        return require_valid_solid(
            mesh_bone(self.build_csg_solid(), self.field, self.edge_mm, (tolerance_mm,))[0], self.name
        )

    @property
    def origin(self) -> CacheKey:
        """Cache key of the solids."""
        return CacheKey(sources=SOURCES, libraries=_LIBRARIES, facts=self.tables)

    def write_to_package(self) -> None:
        """Build the solids and store them in the package, so that users do not have to wait for them."""
        save_to_package(self.name, self.origin, self.make_arrays())

    @cached_property
    def _stored_parts(self) -> tuple[Manifold, Indices, Array]:
        """Return the outer solid, the faces of a coarser surface and the inward paths of its vertices.

        The faces have shape (m, 3). The paths have shape (depths, n, 3) and are in mm.
        """
        arrays = load_or_make_arrays(self.name, self.origin, self.make_arrays)
        ways = np.cumsum(arrays["steps"], axis=0) * _GRID_MM
        return build_solid(arrays["points"] * _GRID_MM, arrays["faces"], self.name), arrays["inner_faces"], ways

    def make_arrays(self) -> Arrays:
        """Build the solids, bypassing the cache, and return them as integer arrays.

        Returns
        -------
        dict of str to int32 array
            "points" and "faces" of the outer solid, "inner_faces" of the coarser surface, and "steps" (depths, n, 3)
            along the inward paths of its vertices. Coordinates are multiples of 2**-20 mm.
        """
        solids = mesh_bone(self.build_csg_solid(), self.field, self.edge_mm, (self.tolerance_mm, _INNER_TOLERANCE_MM))
        outer, coarser = (
            extract_mesh(
                refine_for_deformation(require_valid_solid(solid, self.name), self.shape_model, self.roughness_zones)
            )
            for solid in solids
        )
        ways = [coarser.vertices]
        for depth in _DEPTHS_MM[1:]:
            ways.append(project_to_surface(ways[-1], self.field, partial(_repeat_depth, depth), _STEPS))
        steps = np.diff(_round_to_grid(np.array(ways)), axis=0, prepend=0)
        places = {"points": _round_to_grid(outer.vertices), "steps": steps}
        faces = {"faces": outer.faces, "inner_faces": coarser.faces}
        return {name: values.astype(np.int32) for name, values in (places | faces).items()}


def make_template_bone(
    name: str,
    shape: BoneShapeT,
    field: ScalarField,
    shell_thickness_mm: Callable[[BoneShapeT, Array, float, float | Array], Array],
    build_csg_solid: Callable[[BoneShapeT], Manifold],
    forms: ShapeModel,
) -> TemplateBone:
    """Make a template bone from its shape parameters.

    Parameters
    ----------
    name : str
        Name of the bone.
    shape : FemurShape or TibiaShape
        Shape parameters of the bone.
    field : callable
        Distance field of the outer surface. It maps points (n, 3), in mm, to approximate signed distances (n,), in mm.
    shell_thickness_mm : callable
        Function as in `TemplateBone`, with the shape parameters as an additional first argument.
    build_csg_solid : callable
        Function as in `TemplateBone`, with the shape parameters as its argument.
    forms : ShapeModel
        Statistical shape model. Edges are made short enough for its deformations.

    Returns
    -------
    TemplateBone
        Template bone. Its solids are built or read from the cache at first use.
    """
    return TemplateBone(
        name=name,
        field=field,
        shell_thickness_mm=partial(shell_thickness_mm, shape),
        build_csg_solid=partial(build_csg_solid, shape),
        edge_mm=shape.edge_mm,
        tolerance_mm=shape.tolerance_mm,
        shape_model=build_shape_model(forms).bones[name],
        roughness_zones=shape.roughness_zones,
        tables=encode_records(shape, getattr(forms.lattices, name), forms.modes),
    )


def _round_to_grid(places: Array) -> Indices:
    """Convert coordinates in mm to multiples of the storage grid."""
    return np.round(places / _GRID_MM).astype(np.int64)


def _repeat_depth(depth_mm: float, points: Array) -> Array:
    """Return an array (n,) that repeats one depth, in mm, for all points (n, 3)."""
    return np.full(len(points), depth_mm)


def _interpolate_at_depth(inward_paths: Array, depth_mm: Array) -> Array:
    """Interpolate positions (n, 3) at depths (n,), in mm, along inward paths (depths, n, 3).

    Between two stored depths, the paths are nearly straight.
    """
    depths = np.array(_DEPTHS_MM)
    level = np.clip(np.searchsorted(depths, depth_mm) - 1, 0, len(depths) - 2)
    share = (depth_mm - depths[level]) / (depths[level + 1] - depths[level])
    each = np.arange(len(depth_mm))
    return inward_paths[level, each] + share[:, None] * (inward_paths[level + 1, each] - inward_paths[level, each])


def refine_for_deformation(
    solid: Manifold, shape_model: BoneShapeModel, roughness_zones: tuple[RoughnessZone, ...] = ()
) -> Manifold:
    """Split the edges of a solid until they are short enough for the deformations of the shape model.

    Parameters
    ----------
    solid : Manifold
        Solid at template size.
    shape_model : BoneShapeModel
        Shape model of the bone.
    roughness_zones : tuple of RoughnessZone
        Zones with a rough surface.

    Returns
    -------
    Manifold
        `solid` with shorter mesh edges.

    Raises
    ------
    InputError
        If the refined mesh is not a valid solid.

    Notes
    -----
    An edge is split if deformation would move its midpoint off the edge by more than 0.05 mm. Shapes up to two standard
    deviations from the mean are considered. In roughness zones, edges longer than 2 mm are also split.
    """
    mesh = extract_mesh(solid)

    def bent(places: Array, edges: Indices) -> tuple[Indices, Array]:
        middles = places[edges].mean(axis=1)
        off = _compute_sagitta_mm(places, edges, middles, shape_model) > _BENT_MM
        off |= is_in_zones(middles, roughness_zones) & (lengths(np.diff(places[edges], axis=1)[:, 0]) > _ROUGH_EDGE_MM)
        return edges[off], middles[off]

    return build_solid(*split_selected_edges(mesh.vertices, mesh.faces, _SPLITS, bent), "bone refined for deformation")


def _compute_sagitta_mm(places: Array, edges: Indices, middles: Array, shape_model: BoneShapeModel) -> Array:
    """Compute the distances (n,) by which deformation moves the midpoints of edges (n, 2) off the edges, in mm.

    The distances are computed for shapes two standard deviations from the mean.
    """

    def bend(displacements_mm: Array) -> Array:
        lattice = replace_displacements(shape_model.mean, displacements_mm)
        ends = displace_points(places, lattice) - places
        return lengths(displace_points(middles, lattice) - middles - ends[edges].mean(axis=1))

    spread = np.sqrt(np.sum([bend(mode) ** 2 for mode in shape_model.modes_mm], axis=0))
    return np.asarray(bend(shape_model.mean.displacements_mm) + _FAR_SD * spread)
