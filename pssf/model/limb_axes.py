"""Compute limb angles and length ratios, with the definitions used on radiographs."""

from ..data.anatomy.bone_tables import FemurShape
from .knee import Knee

# Lateral angle between the femoral and tibial axes of a straight leg, in degrees.
STRAIGHT_LEG_DEG = 180.0


def compute_alignment(knee: Knee, femur: FemurShape) -> dict[str, float]:
    """Compute the alignment angles and length ratios that a radiograph of a straight leg would show.

    Parameters
    ----------
    knee : Knee
        Knee whose limb is measured.
    femur : FemurShape
        Femur of the template anatomy; `FemurShape.valgus_deg` is the normal valgus angle between the femoral and tibial
        shafts.

    Returns
    -------
    dict of str to float
        ``femorotibial_deg`` is the lateral angle between the femoral and tibial shafts. ``hip_knee_ankle_deg`` is the
        lateral angle between the mechanical axes. Both angles are 180 for a straight leg and larger in varus.
        ``tibial_slope_deg`` is the mean posterior slope of the medial and lateral plateaus. ``insall_salvati`` is
        `Knee.insall_salvati`.

    Notes
    -----
    The angle between the mechanical axis and the shaft of the femur is `Knee.mechanical_axis_deg`. The mechanical axis
    of the tibia is the tibial shaft. The Osteoarthritis Initiative defines the hip-knee-ankle angle as 180 minus
    ``hip_knee_ankle_deg``, which is negative in varus.
    """
    femorotibial_deg = STRAIGHT_LEG_DEG - femur.valgus_deg + knee.varus_deg
    return {
        "femorotibial_deg": round(femorotibial_deg, 4),
        "hip_knee_ankle_deg": round(femorotibial_deg + knee.mechanical_axis_deg, 4),
        "tibial_slope_deg": knee.tibial_slope_deg,
        "insall_salvati": knee.insall_salvati,
    }
