"""Attrition: where a femur would stand in a tibia the plateau is worn to its form, bone on bone."""

import numpy as np
from manifold3d import Manifold, OpType

from ..core.checks import Array, InputError
from ..geometry.mesh import Mesh
from .bones import Bone
from .joint import KneeAssembly
from .solids import mesh_of

# Between worn bones, which touch in people.
_CONTACT_MM = 0.02
# So deep a plateau may be worn (OARSI's atlas has no number; judgement).
MOST_MM = 4.0
# What is shared by so little is rounding.
_NOTHING_MM3 = 1e-6


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
    femur, tibia = (
        bone.outer.warp_batch(lambda points, move=move: move(np.array(points)))
        for bone, move in ((assembly.femur, assembly.femur_mm), (assembly.tibia, assembly.tibia_mm))
    )
    return mesh_of(femur), mesh_of(worn(Bone(outer=tibia, inner=tibia), femur, 0.0).outer)


def _near(femur: Manifold, box_mm: Array, margin_mm: float) -> Manifold:
    """What of a femur is in a box (2, 3) or as near to it: what is worn has no more to do with the rest."""
    low, high = box_mm[0] - margin_mm, box_mm[1] + margin_mm
    for axis, way in enumerate(np.eye(3)):
        femur = femur.trim_by_plane(tuple(way), low[axis]).trim_by_plane(tuple(-way), -high[axis])
    return femur


def _without(solid: Manifold, femur: Manifold, apart_mm: float) -> Manifold:
    """A solid without a femur and what is so near to it, downwards and to all sides."""
    ways = apart_mm * np.array([[0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return Manifold.batch_boolean([solid, *(femur.translate(way) for way in ways)], OpType.Subtract)
