"""Attrition: how deep a plateau is worn, and bones as they stand without and with that."""

from dataclasses import replace

import numpy as np
from manifold3d import Manifold

from ..geometry.mesh import Mesh
from .contours import COMPARTMENT
from .joint import KneeAssembly
from .solids import mesh_of, solid_of
from .wear import CONTACT_MM, MOST_MM, NOTHING_MM3, near, worn_outer

# A depth is found by halving MOST_MM so often, to a thousandth of a millimetre.
_HALVINGS = 13


def outer_bones(assembly: KneeAssembly) -> tuple[Mesh, Mesh]:
    """Outer surfaces of femur and tibia as they stand, the tibia worn, before they are mirrored."""
    femur, tibia = _standing(assembly)
    return mesh_of(femur), mesh_of(worn_outer(tibia, femur))


def attrition_mm(assembly: KneeAssembly) -> dict[str, float]:
    """Side -> greatest depth, along the leg, that is worn off the plateau in the posture that defines joint spaces.

    Of the plateau beyond its spines, which the notch may wear too. 0 where bones do not meet, and no more than MOST_MM:
    deeper is not built.
    """
    femur, tibia = _standing(replace(assembly, pose=assembly.defined))
    shared = tibia ^ femur
    if shared.volume() <= NOTHING_MM3:
        return {"medial": 0.0, "lateral": 0.0}
    femur = near(femur, np.array(shared.bounding_box()).reshape(2, 3), MOST_MM)
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
        return bool((plateau ^ femur.translate((0.0, 0.0, raised_mm))).volume() > NOTHING_MM3)

    if not meet(0.0):
        return 0.0
    low, high = 0.0, MOST_MM - CONTACT_MM
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if meet(middle) else (low, middle)
    return round(high + CONTACT_MM, 3)


def _standing(assembly: KneeAssembly) -> tuple[Manifold, Manifold]:
    """Outer femur and tibia as they stand, the tibia not worn."""
    return (
        solid_of(assembly.outer_femur_mm(), assembly.femur.mesh.faces, "femur"),
        solid_of(assembly.outer_tibia_mm(), assembly.tibia.mesh.faces, "tibia"),
    )
