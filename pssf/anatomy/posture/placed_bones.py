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
from .knee_assembly import GrownBones, KneeAssembly


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


@dataclass(frozen=True)
class UnplacedBones:
    """Solids of the bones of a right knee, each in its own frame; they are the same for every posture.

    Attributes
    ----------
    solids : dict of str to Bone
        Femur, tibia, fibula and patella, and the fabella if present, in mm. The fibula is in the frame of the tibia.
    is_nested : dict of str to bool
        True for each bone whose trabecular bone is inside its outer surface.
    fabella_frame : (3, 4) float64 array or None
        Transform from the frame of the fabella to the frame of the femur.
    """

    solids: dict[str, bone_shells.Bone]
    is_nested: dict[str, bool]
    fabella_frame: Array | None = None


def build_bones(
    knee: Knee, grown: GrownBones | KneeAssembly, cortex_depths_mm: tuple[Array, Array], executor: Executor
) -> UnplacedBones:
    """Build all bones of a right knee, each in its own frame.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    grown : GrownBones or KneeAssembly
        Femur and tibia with their osteophytes.
    cortex_depths_mm : two (n,) float64 arrays
        Thickness of cortex and subchondral bone plate of femur and tibia, in mm, from `compute_cortex_depths_mm`.
    executor : concurrent.futures.Executor
        Executor for parallel computations.

    Returns
    -------
    UnplacedBones
        Femur, tibia, fibula and patella, and the fabella if present.

    Raises
    ------
    InputError
        If a solid is not valid.
    """
    build = grown.bone_parameters
    femur = bone_shells.build_femur(build, grown.femur, cortex_depths_mm[0])
    tibia = bone_shells.build_tibia(build, grown.tibia, cortex_depths_mm[1])
    patella = small_bones.build_patella(build)
    fibula = small_bones.build_fibula(knee, build, tibia.outer)
    solids = {"femur": femur, "tibia": tibia, "fibula": fibula, "patella": patella}
    in_femur = None
    if knee.fabella_mm:
        solids["fabella"], in_femur = small_bones.build_fabella(knee, build, femur.outer)
    nested = dict(zip(solids, executor.map(is_nested, solids.values()), strict=True))
    return UnplacedBones(solids, nested, in_femur)


def place_bones(knee: Knee, assembly: KneeAssembly, unplaced: UnplacedBones) -> dict[str, PlacedBone]:
    """Place all bones of a right knee in its posture.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    assembly : KneeAssembly
        Bones and their pose.
    unplaced : UnplacedBones
        Solids of the bones, from `build_bones`.

    Returns
    -------
    dict of str to PlacedBone
        Femur, tibia, fibula and patella, and the fabella if present.

    Raises
    ------
    InputError
        If a solid is not valid, if a bone cannot be placed, or if the plateau would be worn too deeply.
    """
    build, pose, solids = assembly.bone_parameters, assembly.pose, unplaced.solids
    in_femur = small_bones.place_patella(knee, build, solids["patella"].outer, solids["femur"].outer, pose)
    still = np.eye(3, 4)
    parts = {
        "femur": (solids["femur"], pose.femur_transform(), build.femur.epiphysis_transform(build.scale)),
        "tibia": (solids["tibia"], pose.tibia_transform(), build.tibia.epiphysis_transform(build.scale)),
        "fibula": (solids["fibula"], pose.tibia_transform(), still),
        "patella": (solids["patella"], compose_transforms(in_femur, pose.femur_transform()), still),
    }
    if unplaced.fabella_frame is not None:
        in_leg = compose_transforms(unplaced.fabella_frame, pose.femur_transform())
        parts["fabella"] = (solids["fabella"], in_leg, still)
    placed = {
        name: PlacedBone(_transform_bone(part, at), compose_transforms(inner, at))
        for name, (part, at, inner) in parts.items()
    }
    plate_mm = build.shape.tibia.plate_mm * max(build.plates.medial, build.plates.lateral) * build.scale
    whole = placed["tibia"].solids
    tibia = wear_tibia(whole, placed["femur"].solids.outer, plate_mm)
    placed |= {"tibia": replace(placed["tibia"], solids=tibia, is_worn=tibia is not whole)}
    return {
        name: part
        if (is_nested(part.solids) if part.is_worn else unplaced.is_nested[name])
        else replace(part, solids=repair_nesting(name, part.solids))
        for name, part in placed.items()
    }


def _transform_bone(part: bone_shells.Bone, transform: Array) -> bone_shells.Bone:
    """Apply a transform (3, 4) to all solids of a bone."""
    canal = None if part.canal is None else part.canal.transform(transform)
    return bone_shells.Bone(outer=part.outer.transform(transform), inner=part.inner.transform(transform), canal=canal)
