"""What lies between the muscles of a right knee: fat planes, the pad behind the patellar tendon, the tendon."""

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import BoneShape, FatPad, Tendon
from .bone_build import eased
from .pose import moved
from .soft import THIGH_FROM_MM
from .solids import checked, column

# Of the sheets between muscles, which are faint, thin and far from any edge that is measured.
_COARSER_MM = 0.03


def fat_pad(part: FatPad, scale: float, tibia_frame: Array) -> Manifold:
    """The infrapatellar fat pad, before bones are taken out of it.

    tibia_frame  (3, 4)  transform of the tibia into the knee frame, mm
    """
    half, centre = np.array(part.half) * scale, np.array(part.centre) * scale
    return Manifold.sphere(1.0, 36).scale(half).translate(centre).transform(tibia_frame)


def tendon(part: Tendon, scale: float, apex_mm: Array, tibia_frame: Array) -> Manifold:
    """The patellar tendon, a strap from the patella's apex to the tuberosity, before bones are taken out of it.

    apex_mm      (3,)    of the patella, in the knee frame
    tibia_frame  (3, 4)  transform of the tibia into the knee frame, mm
    """
    on_apex = apex_mm + np.array(part.from_apex) * scale
    ends = []
    for place in (on_apex, moved(np.array([part.tuberosity]) * scale, tibia_frame)[0]):
        ends.append(Manifold.sphere(1.0, 32).scale(np.array(part.half) * scale).translate(place))
    return checked(Manifold.batch_hull(ends), "patellar tendon")


def fat_planes(shape: BoneShape, scale: float, flexion_deg: float) -> list[Manifold]:
    """Thin sheets along the limb, in the leg's frame; those of the thigh follow its flexion."""
    fall = np.tan(np.deg2rad(flexion_deg))

    def bent(points: Array) -> Array:
        back = fall * eased(points[:, 2] - THIGH_FROM_MM)
        return np.column_stack((points[:, 0], points[:, 1] + back, points[:, 2]))

    sheets = []
    for part in shape.fat_planes:
        rows = np.array(part.sections) * scale
        heights = np.linspace(rows[:, 0].min(), rows[:, 0].max(), 24)
        sheet = column(rows, np.zeros_like, heights, "fat plane", power=2.0, count=48).simplify(_COARSER_MM)
        middle = rows[:, [4, 3]].mean(axis=0)
        turned = sheet.translate((-middle[0], -middle[1], 0.0)).rotate((0.0, 0.0, part.turn_deg))
        sheets.append(turned.translate((middle[0], middle[1], 0.0)).warp_batch(bent))
    return sheets
