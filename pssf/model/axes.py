"""axes: a knee -> its angles and ratios as they are read on films."""

from ..data.bones import FemurShape
from .knee import Knee

STRAIGHT_DEG = 180.0


def axes(knee: Knee, femur: FemurShape) -> dict[str, float]:
    """Angles of the straight leg, lateral, 180 straight and more varus, and ratios, by name.

    femorotibial_deg    of the shafts
    hip_knee_ankle_deg  of the mechanical axes; the Osteoarthritis Initiative's is 180 less this, varus negative. The
                        femur's is as far from its shaft as `Knee.mechanical_axis_deg` says; the tibia's is its shaft's
    tibial_slope_deg    mean of both sides
    insall_salvati      as `Knee`

    femur  the mean man's
    """
    femorotibial_deg = STRAIGHT_DEG - femur.valgus_deg + knee.varus_deg
    return {
        "femorotibial_deg": round(femorotibial_deg, 4),
        "hip_knee_ankle_deg": round(femorotibial_deg + knee.mechanical_axis_deg, 4),
        "tibial_slope_deg": knee.tibial_slope_deg,
        "insall_salvati": knee.insall_salvati,
    }
