"""axes: a knee -> its angles and ratios as they are read on films."""

from ..data.bones import FemurShape
from .knee import Knee

_STRAIGHT_DEG = 180.0


def axes(knee: Knee, femur: FemurShape) -> dict[str, float]:
    """femorotibial_deg (lateral angle of the shafts of the straight leg: 180 straight, more is varus), tibial_slope_deg
    (mean of both sides) and insall_salvati.

    femur  the mean man's

    A hip-knee-ankle angle is not among them: a knee has neither a femoral head nor an ankle, and the angle from the
    femur's shaft to its mechanical axis, which people spread in (2.9 to 6.8 deg, PMC7875943), is no parameter of it.
    """
    valgus_deg = femur.valgus_deg - knee.varus_deg
    return {
        "femorotibial_deg": round(_STRAIGHT_DEG - valgus_deg, 4),
        "tibial_slope_deg": knee.tibial_slope_deg,
        "insall_salvati": knee.insall_salvati,
    }
