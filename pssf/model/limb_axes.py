"""Angles and ratios of the limb, as they are measured on radiographs."""

from ..data.anatomy.bone_tables import FemurShape
from .knee import Knee

# Lateral angle between the axes of femur and tibia in a straight leg, in degrees.
STRAIGHT_LEG_DEG = 180.0


def compute_alignment(knee: Knee, femur: FemurShape) -> dict[str, float]:
    """Compute the alignment angles and the ratios of a limb, as they are measured on radiographs of a straight leg.

    Parameters
    ----------
    knee : Knee
        The knee.
    femur : FemurShape
        Femur of the template anatomy; its `valgus_deg` is the normal valgus angle between the shafts.

    Returns
    -------
    dict of str to float
        ``femorotibial_deg`` is the lateral angle between the shafts of femur and tibia. ``hip_knee_ankle_deg`` is the
        lateral angle between the mechanical axes. Both are 180 for a straight leg and larger in varus.
        ``tibial_slope_deg`` is the mean posterior slope of both plateaus. ``insall_salvati`` is `Knee.insall_salvati`.

    Notes
    -----
    The mechanical axis of the femur differs from its shaft by `Knee.mechanical_axis_deg`. The mechanical axis of the
    tibia is its shaft. The hip-knee-ankle angle of the Osteoarthritis Initiative is 180 minus ``hip_knee_ankle_deg``,
    so it is negative in varus.
    """
    femorotibial_deg = STRAIGHT_LEG_DEG - femur.valgus_deg + knee.varus_deg
    return {
        "femorotibial_deg": round(femorotibial_deg, 4),
        "hip_knee_ankle_deg": round(femorotibial_deg + knee.mechanical_axis_deg, 4),
        "tibial_slope_deg": knee.tibial_slope_deg,
        "insall_salvati": knee.insall_salvati,
    }
