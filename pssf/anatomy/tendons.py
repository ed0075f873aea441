"""What moves the patella and what lies below it: both tendons, and the pad behind the patellar one."""

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.soft import FatPad, PatellarTendon, QuadricepsTendon
from .pose import moved
from .solids import checked


def fat_pad(part: FatPad, scale: float, tibia_frame: Array, sheath_mm: float = 0.0) -> Manifold:
    """The infrapatellar fat pad, before bones are taken out of it, and so much about it.

    tibia_frame  (3, 4)  transform of the tibia into the knee frame, mm
    """
    half, centre = np.array(part.half) * scale + sheath_mm, np.array(part.centre) * scale
    return Manifold.sphere(1.0, 36).scale(half).translate(centre).transform(tibia_frame)


def patellar_tendon(
    part: PatellarTendon, scale: float, apex_mm: Array, tibia_frame: Array, sheath_mm: float = 0.0
) -> Manifold:
    """A strap from the patella's apex to the tuberosity, before bones are taken out of it, and so much about it.

    apex_mm      (3,)    of the patella, in the knee frame
    tibia_frame  (3, 4)  transform of the tibia into the knee frame, mm
    """
    ends = [apex_mm + np.array(part.from_apex) * scale, moved(np.array([part.tuberosity]) * scale, tibia_frame)[0]]
    return _strap([(end, part.half) for end in ends], scale, sheath_mm, "patellar tendon")


def quadriceps_tendon(
    part: QuadricepsTendon, scale: float, base_mm: Array, femur_frame: Array, sheath_mm: float = 0.0
) -> Manifold:
    """A strap from the patella's base up the front of the femur, before bones are taken out, and so much about it.

    base_mm      (3,)    highest place of the patella, in the knee frame
    femur_frame  (3, 4)  transform of the femur into the knee frame, mm
    """
    turn = femur_frame[:, :3]
    low = base_mm + turn @ (np.array(part.from_base) * scale)
    high = low + turn @ (np.array(part.upwards) * scale)
    return _strap([(low, part.half_below), (high, part.half_above)], scale, sheath_mm, "quadriceps tendon")


def _strap(ends: list[tuple[Array, tuple[float, float, float]]], scale: float, sheath_mm: float, name: str) -> Manifold:
    """The hull of an ellipsoid at either end."""
    ball = Manifold.sphere(1.0, 24)
    solids = [ball.scale(np.array(half) * scale + sheath_mm).translate(place) for place, half in ends]
    return checked(Manifold.batch_hull(solids), name)
