"""Attrition: measure the depth of plateau wear, and build the posed bones with and without wear."""

from dataclasses import replace

import numpy as np
from manifold3d import Manifold

from ...geometry.mesh import Mesh
from ..bones.plateau_wear import (
    CONTACT_MM,
    MAX_WEAR_MM,
    ROUNDING_MM3,
    crop_to_box,
    wear_outer_tibia,
)
from ..meshing.solids import build_solid, extract_mesh
from ..outlines.projected_contours import COMPARTMENT_RANGE
from .knee_assembly import KneeAssembly

# Number of bisections between 0 and the largest depth of wear. They determine the depth to 0.001 mm.
_BISECTIONS = 13


def build_outer_meshes(assembly: KneeAssembly) -> tuple[Mesh, Mesh]:
    """Build the outer surfaces of the femur and the worn tibia in their pose, before mirroring.

    Parameters
    ----------
    assembly : KneeAssembly
        Knee in its posture.

    Returns
    -------
    femur : Mesh
        Outer surface of the femur in the leg frame, in mm.
    tibia : Mesh
        Outer surface of the worn tibia in the leg frame, in mm.

    Raises
    ------
    InputError
        If the wear would be deeper than `MAX_WEAR_MM`.
    """
    femur, tibia = _build_posed_solids(assembly)
    return extract_mesh(femur), extract_mesh(wear_outer_tibia(tibia, femur))


def measure_attrition_mm(assembly: KneeAssembly) -> dict[str, float]:
    """Measure the largest depth of plateau wear per compartment, in the posture that defines JSW.

    The depth is measured along the leg, on the plateau outside the spines. The spines are excluded, because contact
    with the notch may wear them too.

    Parameters
    ----------
    assembly : KneeAssembly
        Knee in its posture.

    Returns
    -------
    dict of str to float
        Depth in mm for "medial" and "lateral". The depth is 0 where the bones do not overlap. It is at most
        `MAX_WEAR_MM`, because deeper wear is rejected.
    """
    femur, tibia = _build_posed_solids(replace(assembly, pose=assembly.jsw_pose))
    shared = tibia ^ femur
    if shared.volume() <= ROUNDING_MM3:
        return {"medial": 0.0, "lateral": 0.0}
    femur = crop_to_box(femur, np.array(shared.bounding_box()).reshape(2, 3), MAX_WEAR_MM)
    frame, from_mm = assembly.jsw_pose.tibia_transform(), COMPARTMENT_RANGE[0] * assembly.bone_parameters.half_ml_mm
    depths = {}
    for side, sign in (("medial", 1.0), ("lateral", -1.0)):
        across = sign * frame[:, 0]
        plateau = tibia.trim_by_plane(tuple(across), float(across @ frame[:, 3]) + from_mm)
        depths[side] = _measure_depth_mm(plateau, femur)
    return depths


def _measure_depth_mm(plateau: Manifold, femur: Manifold) -> float:
    """Measure the distance by which the femur must be raised to clear the plateau, including the contact gap, in mm."""

    def meet(raised_mm: float) -> bool:
        return bool((plateau ^ femur.translate((0.0, 0.0, raised_mm))).volume() > ROUNDING_MM3)

    if not meet(0.0):
        return 0.0
    low, high = 0.0, MAX_WEAR_MM - CONTACT_MM
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if meet(middle) else (low, middle)
    return round(high + CONTACT_MM, 3)


def _build_posed_solids(assembly: KneeAssembly) -> tuple[Manifold, Manifold]:
    """Build the outer solids of femur and tibia in their pose, without wear."""
    return (
        build_solid(assembly.outer_femur_vertices_mm(), assembly.femur.mesh.faces, "femur"),
        build_solid(assembly.outer_tibia_vertices_mm(), assembly.tibia.mesh.faces, "tibia"),
    )
