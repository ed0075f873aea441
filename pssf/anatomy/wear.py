"""Attrition: where a femur would stand in a tibia the plateau is worn to its form, bone on bone."""

from dataclasses import replace

import numpy as np
from manifold3d import Manifold, OpType

from ..core.checks import Array, InputError
from ..geometry.mesh import Mesh
from .bones import Bone
from .contours import COMPARTMENT
from .joint import KneeAssembly
from .solids import mesh_of

# Between worn bones, which touch in people.
_CONTACT_MM = 0.02
# So deep a plateau or a spine may be worn (OARSI's atlas has no number; judgement): a tall spine with a spike stands
# 6 mm in the wall of a narrow notch, as bones have it whose shape is 3 deviations off in every mode.
MOST_MM = 7.0
# What is shared by so little is rounding.
_NOTHING_MM3 = 1e-6
# A depth is found by halving MOST_MM so often, to a thousandth of a millimetre.
_HALVINGS = 13


def worn(tibia: Bone, femur: Manifold, plate_mm: float) -> Bone:
    """A tibia without what the femur stands in, under a plate as thick as elsewhere; itself where they do not meet.

    tibia, femur  in the knee frame
    plate_mm      thickness of the plate under the worn surface
    raises        InputError where that would be deeper than MOST_MM
    """
    shared = tibia.outer ^ femur
    if shared.volume() <= _NOTHING_MM3:
        return tibia
    if (tibia.outer ^ femur.translate((0.0, 0.0, MOST_MM))).volume() > _NOTHING_MM3:
        raise InputError(
            f"femur and tibia overlap by {shared.volume():.3g} mm3, in places by more than {MOST_MM:g} mm (joint "
            "spaces, osteophytes and pose leave them no room); allowed: less, which is worn off the plateau"
        )
    near = _near(femur, np.array(shared.bounding_box()).reshape(2, 3), _CONTACT_MM + plate_mm)
    return Bone(
        outer=_without(tibia.outer, near, _CONTACT_MM),
        inner=_without(tibia.inner, near, _CONTACT_MM + plate_mm),
        canal=tibia.canal,
    )


def outer_bones(assembly: KneeAssembly) -> tuple[Mesh, Mesh]:
    """Outer surfaces of femur and tibia as they stand, the tibia worn, before they are mirrored."""
    femur, tibia = _standing(assembly)
    return mesh_of(femur), mesh_of(worn(Bone(outer=tibia, inner=tibia), femur, 0.0).outer)


def attrition_mm(assembly: KneeAssembly) -> dict[str, float]:
    """Side -> greatest depth, along the leg, that is worn off the plateau in the posture that defines joint spaces.

    Of the plateau beyond its spines, which the notch may wear too. 0 where bones do not meet, and no more than MOST_MM:
    deeper is not built.
    """
    femur, tibia = _standing(replace(assembly, pose=assembly.defined))
    shared = tibia ^ femur
    if shared.volume() <= _NOTHING_MM3:
        return {"medial": 0.0, "lateral": 0.0}
    femur = _near(femur, np.array(shared.bounding_box()).reshape(2, 3), MOST_MM)
    frame, from_mm = assembly.defined.tibia(), COMPARTMENT[0] * assembly.build.half_ml_mm
    depths = {}
    for side, sign in (("medial", 1.0), ("lateral", -1.0)):
        across = sign * frame[:, 0]
        plateau = tibia.trim_by_plane(tuple(across), float(across @ frame[:, 3]) + from_mm)
        depths[side] = _depth_mm(plateau, femur)
    return depths


def _depth_mm(plateau: Manifold, femur: Manifold) -> float:
    """How deep a femur stands in a plateau, and the contact beneath it: what it must be raised by to be clear."""

    def meet(raised_mm: float) -> bool:
        return bool((plateau ^ femur.translate((0.0, 0.0, raised_mm))).volume() > _NOTHING_MM3)

    if not meet(0.0):
        return 0.0
    low, high = 0.0, MOST_MM - _CONTACT_MM
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if meet(middle) else (low, middle)
    return round(high + _CONTACT_MM, 3)


def _standing(assembly: KneeAssembly) -> tuple[Manifold, Manifold]:
    """Outer femur and tibia as they stand, the tibia not worn."""
    femur, tibia = (
        bone.outer.warp_batch(lambda points, move=move: move(np.array(points)))
        for bone, move in ((assembly.femur, assembly.femur_mm), (assembly.tibia, assembly.tibia_mm))
    )
    return femur, tibia


def _near(femur: Manifold, box_mm: Array, margin_mm: float) -> Manifold:
    """What of a femur is in a box (2, 3) or as near to it: what is worn has no more to do with the rest."""
    low, high = box_mm[0] - margin_mm, box_mm[1] + margin_mm
    for axis, way in enumerate(np.eye(3)):
        femur = femur.trim_by_plane(tuple(way), low[axis]).trim_by_plane(tuple(-way), -high[axis])
    return femur


def _without(solid: Manifold, femur: Manifold, apart_mm: float) -> Manifold:
    """A solid without a femur and what is so near to it, downwards and to all sides."""
    # The femur itself too: an edge of it may be thinner than the way that its copies go.
    ways = apart_mm * np.array([[0, 0, 0], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return Manifold.batch_boolean([solid, *(femur.translate(way) for way in ways)], OpType.Subtract)
