"""place_bones: the bones of a knee as solids, each where it stands in the leg."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..model.knee import Knee
from . import bones, small_bones
from .joint import KneeAssembly
from .pose import composed
from .shells import drawn_in, is_nested
from .wear import worn


@dataclass(frozen=True)
class PlacedBone:
    """Solids of a bone in the knee frame, and the (3, 4) transform into it from the frame of its trabeculae.

    worn  whether another bone has taken of it
    """

    solids: bones.Bone
    frame: Array
    worn: bool = False


def place_bones(
    knee: Knee, assembly: KneeAssembly, shells_mm: tuple[Array, Array], aside: Executor
) -> dict[str, PlacedBone]:
    """Place femur, tibia, fibula, patella and fabella, if there is one, of a right knee as it stands; by name.

    shells_mm  of `bones.shells_mm`: of femur and of tibia (vertices,) depths of the cortex
    """
    build, pose = assembly.build, assembly.pose
    femur = bones.femur(build, assembly.femur, shells_mm[0])
    tibia = bones.tibia(build, assembly.tibia, shells_mm[1])
    patella = small_bones.patella(build)
    place = aside.submit(small_bones.patella_place, knee, build, patella.outer, femur.outer, pose)
    fibula, still = small_bones.fibula(knee, build, tibia.outer), np.eye(3, 4)
    parts = {
        "femur": (femur, pose.femur(), build.femur.frame(build.scale)),
        "tibia": (tibia, pose.tibia(), build.tibia.frame(build.scale)),
        "fibula": (fibula, pose.tibia(), still),
        "patella": (patella, composed(place.result(), pose.femur()), still),
    }
    if knee.fabella_mm:
        fabella, in_femur = small_bones.fabella(knee, build, femur.outer)
        parts["fabella"] = (fabella, composed(in_femur, pose.femur()), still)
    placed = {name: PlacedBone(_placed(part, at), composed(inner, at)) for name, (part, at, inner) in parts.items()}
    plate_mm = build.shape.tibia.plate_mm * max(build.plates.medial, build.plates.lateral) * build.scale
    whole = placed["tibia"].solids
    tibia = worn(whole, placed["femur"].solids.outer, plate_mm)
    placed |= {"tibia": replace(placed["tibia"], solids=tibia, worn=tibia is not whole)}
    nests = dict(zip(placed, aside.map(lambda part: is_nested(part.solids), placed.values()), strict=True))
    return {
        name: part if nests[name] else replace(part, solids=drawn_in(name, part.solids))
        for name, part in placed.items()
    }


def _placed(part: bones.Bone, transform: Array) -> bones.Bone:
    canal = None if part.canal is None else part.canal.transform(transform)
    return bones.Bone(outer=part.outer.transform(transform), inner=part.inner.transform(transform), canal=canal)
