"""Placed bones: solids of all bones of a knee in the knee frame."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from ...core.checks import Array
from ...model.knee import Knee
from ..bones import bone_shells, small_bones
from ..bones.plateau_wear import wear_tibia
from ..bones.shell_checks import is_nested, repair_nesting
from ..meshing.rigid_pose import compose_transforms
from .knee_assembly import KneeAssembly


@dataclass(frozen=True)
class PlacedBone:
    """Solids of one bone in the knee frame.

    Attributes
    ----------
    solids : Bone
        Nested solids of the bone, in mm.
    frame : (3, 4) float64 array
        Transform from the frame of the trabecular bone to the knee frame: rotation and translation (mm).
    is_worn : bool
        True if another bone has worn this bone.
    """

    solids: bone_shells.Bone
    frame: Array
    is_worn: bool = False


def place_bones(
    knee: Knee, assembly: KneeAssembly, cortex_depths_mm: tuple[Array, Array], executor: Executor
) -> dict[str, PlacedBone]:
    """Build and place all bones of a right knee in its posture.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    assembly : KneeAssembly
        Bones and their pose.
    cortex_depths_mm : two (n,) float64 arrays
        Thickness of cortex and subchondral bone plate of femur and tibia, in mm, from `compute_cortex_depths_mm`.
    executor : concurrent.futures.Executor
        Executor for parallel computations.

    Returns
    -------
    dict of str to PlacedBone
        Femur, tibia, fibula and patella, and the fabella if present.

    Raises
    ------
    InputError
        If a solid is not valid, if a bone cannot be placed, or if the plateau would be worn too deeply.
    """
    build, pose = assembly.bone_parameters, assembly.pose
    femur = bone_shells.build_femur(build, assembly.femur, cortex_depths_mm[0])
    tibia = bone_shells.build_tibia(build, assembly.tibia, cortex_depths_mm[1])
    patella = small_bones.build_patella(build)
    place = executor.submit(small_bones.place_patella, knee, build, patella.outer, femur.outer, pose)
    fibula, still = small_bones.build_fibula(knee, build, tibia.outer), np.eye(3, 4)
    parts = {
        "femur": (femur, pose.femur_transform(), build.femur.epiphysis_transform(build.scale)),
        "tibia": (tibia, pose.tibia_transform(), build.tibia.epiphysis_transform(build.scale)),
        "fibula": (fibula, pose.tibia_transform(), still),
        "patella": (patella, compose_transforms(place.result(), pose.femur_transform()), still),
    }
    if knee.fabella_mm:
        fabella, in_femur = small_bones.build_fabella(knee, build, femur.outer)
        parts["fabella"] = (fabella, compose_transforms(in_femur, pose.femur_transform()), still)
    placed = {
        name: PlacedBone(_transform_bone(part, at), compose_transforms(inner, at))
        for name, (part, at, inner) in parts.items()
    }
    plate_mm = build.shape.tibia.plate_mm * max(build.plates.medial, build.plates.lateral) * build.scale
    whole = placed["tibia"].solids
    tibia = wear_tibia(whole, placed["femur"].solids.outer, plate_mm)
    placed |= {"tibia": replace(placed["tibia"], solids=tibia, is_worn=tibia is not whole)}
    nests = dict(zip(placed, executor.map(lambda part: is_nested(part.solids), placed.values()), strict=True))
    return {
        name: part if nests[name] else replace(part, solids=repair_nesting(name, part.solids))
        for name, part in placed.items()
    }


def _transform_bone(part: bone_shells.Bone, transform: Array) -> bone_shells.Bone:
    """Apply a transform (3, 4) to all solids of a bone."""
    canal = None if part.canal is None else part.canal.transform(transform)
    return bone_shells.Bone(outer=part.outer.transform(transform), inner=part.inner.transform(transform), canal=canal)
