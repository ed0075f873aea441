"""Bone shells: nested solids of femur and tibia for cortex, trabecular bone and medullary canal."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array
from ...data.anatomy.bone_tables import FemurShape, TibiaShape
from ...geometry.mesh import Mesh
from ...geometry.mesh_cut import cut_mesh_at_height
from ...model.knee import Osteophyte
from ..meshing.solids import (
    build_solid,
    extract_mesh,
    loft_column,
    make_thickness_profile,
)
from ..template.bone_builder import (
    BoneParameters,
    deform_template_points,
    scale_and_lean_femur,
    scale_sections,
    scale_slope_and_lean_tibia,
)
from ..template.cortical_unevenness import MAX_SD, compute_thickness_factor
from ..template.template_bone import TemplateBone
from .osteophyte_growth import BoneWithOsteophytes, grow_osteophytes

# Distance of the cut ends of the shafts from z = 0, in mm. The ends are outside the beam of every protocol and inside
# the soft tissue.
SHAFT_END_MM = 180.0
# Length added to a medullary canal before it is deformed and cut, in mm.
_CANAL_EXTRA_MM = 20.0
# Distance between two rings of a canal, in mm. With 48 points per ring, the triangles are within 0.05 mm of the
# surface.
_RING_MM = 5.0
# Number of points per ring of a canal. A coarse mesh is sufficient, because trabeculae blur the edge of the canal.
_AROUND = 48
# Clearance between the canal and a cortex of mean thickness, in mm. The variation in cortical thickness is added to
# this clearance.
_CANAL_CLEARANCE_MM = 0.4


@dataclass(frozen=True)
class Bone:
    """Nested solids of one bone, in mm.

    Parameters
    ----------
    outer : Manifold
        Solid bounded by the outer surface of the bone. Cortex and subchondral bone plate fill the volume between
        `outer` and `inner`.
    inner : Manifold
        Solid bounded by the surface of the trabecular bone.
    canal : Manifold or None
        Medullary canal, filled with marrow. None if the bone has no canal.
    """

    outer: Manifold
    inner: Manifold
    canal: Manifold | None = None


def space_ring_heights(low_mm: float, high_mm: float, step_mm: float) -> Array:
    """Compute equally spaced heights for the rings of a loft.

    Parameters
    ----------
    low_mm : float
        Lowest height, in mm.
    high_mm : float
        Highest height, in mm.
    step_mm : float
        Approximate distance between two rings, in mm.

    Returns
    -------
    (n,) float64 array
        At least two heights in mm, including `low_mm` and `high_mm`.
    """
    return np.linspace(low_mm, high_mm, max(2, round((high_mm - low_mm) / step_mm) + 1))


def grow_femur_osteophytes(bone_parameters: BoneParameters, osteophytes: tuple[Osteophyte, ...]) -> BoneWithOsteophytes:
    """Add the femoral osteophytes to the outer surface of the femur.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    osteophytes : tuple of Osteophyte
        All osteophytes of the knee; osteophytes of other bones are ignored.

    Returns
    -------
    BoneWithOsteophytes
        Outer femur at template size, in its own frame.

    Raises
    ------
    InputError
        If one osteophyte hides the farthest point of another osteophyte.
    """
    mean, margins = bone_parameters.template_femur, bone_parameters.shape.osteophytes
    return grow_osteophytes(
        osteophytes,
        mean,
        margins,
        bone_parameters.scale,
        partial(deform_template_points, deformation=bone_parameters.femur),
    )


def grow_tibia_osteophytes(bone_parameters: BoneParameters, osteophytes: tuple[Osteophyte, ...]) -> BoneWithOsteophytes:
    """Add the tibial osteophytes to the outer surface of the tibia.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    osteophytes : tuple of Osteophyte
        All osteophytes of the knee; osteophytes of other bones are ignored.

    Returns
    -------
    BoneWithOsteophytes
        Outer tibia at template size, in its own frame.

    Raises
    ------
    InputError
        If one osteophyte hides the farthest point of another osteophyte.
    """
    mean, margins = bone_parameters.template_tibia, bone_parameters.shape.osteophytes
    return grow_osteophytes(
        osteophytes,
        mean,
        margins,
        bone_parameters.scale,
        partial(deform_template_points, deformation=bone_parameters.tibia),
    )


def prepare_template_bones(bone_parameters: BoneParameters) -> None:
    """Build the template femur and tibia, or read them from the cache, in parallel.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    """
    # The first build of a template bone after installation takes seconds, so two threads build both bones in parallel.
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(TemplateBone.prepare, (bone_parameters.template_femur, bone_parameters.template_tibia)))


def compute_cortex_depths_mm(bone_parameters: BoneParameters) -> tuple[Array, Array]:
    """Compute the thickness of cortex and subchondral bone plate of femur and tibia.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    femur : (n,) float64 array
        Thickness at each vertex of the coarse surface of the template femur, in mm at template size.
    tibia : (m,) float64 array
        Thickness at each vertex of the coarse surface of the template tibia, in mm at template size.
    """
    uneven = partial(compute_thickness_factor, table=bone_parameters.shape.unevenness, seed=bone_parameters.seed)
    return (
        bone_parameters.template_femur.compute_depth_mm(
            bone_parameters.cortex_scale, bone_parameters.plates, partial(uneven, bone="femur")
        ),
        bone_parameters.template_tibia.compute_depth_mm(
            bone_parameters.cortex_scale, bone_parameters.plates, partial(uneven, bone="tibia")
        ),
    )


def build_femur(bone_parameters: BoneParameters, outer_bone: BoneWithOsteophytes, cortex_depth_mm: Array) -> Bone:
    """Build the nested solids of the distal femur.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    outer_bone : BoneWithOsteophytes
        Outer surface of the femur with its osteophytes.
    cortex_depth_mm : (n,) float64 array
        Thickness of cortex and subchondral bone plate, in mm, from `compute_cortex_depths_mm`.

    Returns
    -------
    Bone
        Solids in the frame of the femur, with z = 0 near the distal end of the condyles. The shaft leans laterally by
        `femur_valgus_deg`.

    Raises
    ------
    InputError
        If a surface is not a valid solid.
    """
    table, s, mean = bone_parameters.shape.femur, bone_parameters.scale, bone_parameters.template_femur
    marrow = mean.build_inner_mesh(cortex_depth_mm)
    heights = space_ring_heights(table.canal_from_z_mm, (SHAFT_END_MM + _CANAL_EXTRA_MM) / s, _RING_MM)
    return _build_nested_solids(
        bone_parameters,
        "femur",
        outer_bone,
        outer_bone.build_trabecular_mesh(marrow, s),
        _build_canal(bone_parameters, table, heights),
    )


def build_tibia(bone_parameters: BoneParameters, outer_bone: BoneWithOsteophytes, cortex_depth_mm: Array) -> Bone:
    """Build the nested solids of the proximal tibia.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    outer_bone : BoneWithOsteophytes
        Outer surface of the tibia with its osteophytes.
    cortex_depth_mm : (n,) float64 array
        Thickness of cortex and subchondral bone plate, in mm, from `compute_cortex_depths_mm`.

    Returns
    -------
    Bone
        Solids in the frame of the tibia, with z = 0 near the centre of the plateau. The shaft leans medially by
        `tibia_varus_deg`.

    Raises
    ------
    InputError
        If a surface is not a valid solid.
    """
    table, s, mean = bone_parameters.shape.tibia, bone_parameters.scale, bone_parameters.template_tibia
    marrow = mean.build_inner_mesh(cortex_depth_mm)
    heights = space_ring_heights(-(SHAFT_END_MM + _CANAL_EXTRA_MM) / s, table.canal_from_z_mm, _RING_MM)
    return _build_nested_solids(
        bone_parameters,
        "tibia",
        outer_bone,
        outer_bone.build_trabecular_mesh(marrow, s),
        _build_canal(bone_parameters, table, heights),
    )


def _build_nested_solids(
    bone_parameters: BoneParameters, name: str, outer_bone: BoneWithOsteophytes, inner: Mesh, canal: Manifold
) -> Bone:
    """Deform, scale and cut the surfaces of a bone. The shafts of inner surfaces are cut closer to the joint."""
    up, stood = (1, scale_and_lean_femur) if name == "femur" else (-1, scale_slope_and_lean_tibia)
    marrow = extract_mesh(canal)
    solids = []
    for formed_mm, faces, short_mm in (
        (outer_bone.deformed_vertices_mm, outer_bone.mesh.faces, 0.0),
        (outer_bone.deform(inner.vertices), inner.faces, 2.0),
        (outer_bone.deform(marrow.vertices), marrow.faces, 4.0),
    ):
        cut = cut_mesh_at_height(Mesh(stood(formed_mm, bone_parameters), faces), up, up * (SHAFT_END_MM - short_mm))
        solids.append(build_solid(*cut, name))
    return Bone(*solids)


def _build_canal(bone_parameters: BoneParameters, shaft: FemurShape | TibiaShape, heights: Array) -> Manifold:
    """Build the medullary canal, which widens from a point in the metaphysis to its full width at `canal_full_z_mm`."""
    cortex, full_z_mm = make_thickness_profile(shaft.cortex, bone_parameters.cortex_scale), shaft.canal_full_z_mm
    clear_mm = (
        _CANAL_CLEARANCE_MM
        + MAX_SD
        * bone_parameters.shape.unevenness.sd
        * bone_parameters.shape.unevenness.thin_mm
        * bone_parameters.cortex_scale
    )
    tip = heights[0] if abs(heights[0] - full_z_mm) < abs(heights[-1] - full_z_mm) else heights[-1]
    table = scale_sections(shaft.sections, 1.0)
    table = table[np.argsort(table[:, 0])]

    def inset(z_mm: Array) -> Array:
        opening = np.clip((z_mm - tip) / (full_z_mm - tip), 0.0, 1.0)
        room = np.minimum(*(np.interp(z_mm, table[:, 0], table[:, k]) for k in (1, 2))) - cortex(z_mm)
        return cortex(z_mm) + clear_mm + (room - _CANAL_CLEARANCE_MM - clear_mm) * (1 - np.sin(opening * np.pi / 2))

    return loft_column(table, inset, heights, "canal", count=_AROUND, strip_caps=True)
