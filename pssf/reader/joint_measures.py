"""Joint space widths, plateau width and joint-line convergence from the sixteen contour landmarks of a radiograph.

The joint space is the gap between the two lines through the landmarks of femur and tibia, as in the statistics of
annotated radiographs (``data/landmarks.toml``).
"""

from dataclasses import dataclass

import numpy as np

from ..anatomy.labels.radiograph_labels import JSW_FRACTIONS
from ..anatomy.outlines.contour_landmarks import CONTOUR_LANDMARKS, FEMORAL_LANDMARKS, TIBIAL_LANDMARKS
from ..core.checks import Array

# Positions at which the smallest joint space is searched for: distances from the femoral edge of the compartment, as
# fractions of the femoral width (Tiulpin et al. 2019, as in `data/landmarks.toml`).
_SEARCHED = np.linspace(0.1, 0.3, 81)
_TIBIA = slice(0, len(TIBIAL_LANDMARKS))
_FEMUR = slice(len(TIBIAL_LANDMARKS), len(TIBIAL_LANDMARKS) + len(FEMORAL_LANDMARKS))


@dataclass(frozen=True, kw_only=True)
class JointMeasures:
    """Widths of the joint as fractions of the plateau width, and angle between the joint lines.

    Attributes
    ----------
    plateau_width_px : float
        Distance between the edges of the tibial plateau, in pixels.
    medial_jsw_share, lateral_jsw_share : float
        Minimum joint space width of each compartment.
    jsw_at_share : dict of float to float
        Joint space width at fractions of the femoral width from the medial edge.
    joint_line_convergence_deg : float
        Angle between the femoral and the tibial joint line, in degrees; positive if the joint opens medially.
    """

    plateau_width_px: float
    medial_jsw_share: float
    lateral_jsw_share: float
    jsw_at_share: dict[float, float]
    joint_line_convergence_deg: float


def measure_joint(landmarks_px: Array, side: str) -> JointMeasures:
    """Measure the joint on one radiograph.

    Parameters
    ----------
    landmarks_px : (16, 2) array
        Row and column of each landmark in the order of `CONTOUR_LANDMARKS`, in pixels.
    side : {"right", "left"}
        Side of the knee.

    Returns
    -------
    JointMeasures
        Widths and angle.
    """
    medial = 1.0 if side == "right" else -1.0
    places = np.column_stack((landmarks_px[:, 1] * medial, -landmarks_px[:, 0]))
    lateral_edge, medial_edge = places[0], places[len(TIBIAL_LANDMARKS) - 1]
    across = medial_edge - lateral_edge
    width = float(np.hypot(*across))
    along = across / width
    upright = (places - (lateral_edge + medial_edge) / 2) @ np.array([along, (-along[1], along[0])]).T / width
    tibia, femur = upright[_TIBIA], upright[_FEMUR]
    ends = femur[-1, 0], femur[0, 0]

    def measure_gap(fractions: Array) -> Array:
        """Measure the gap at fractions of the femoral width from the medial edge."""
        x = ends[0] + fractions * (ends[1] - ends[0])
        return np.interp(x, femur[:, 0], femur[:, 1]) - np.interp(x, tibia[:, 0], tibia[:, 1])

    condyles = [upright[CONTOUR_LANDMARKS.index(f"femur_{name}_condyle")] for name in ("lateral", "medial")]
    lean = condyles[1] - condyles[0]
    return JointMeasures(
        plateau_width_px=width,
        medial_jsw_share=float(measure_gap(_SEARCHED).min()),
        lateral_jsw_share=float(measure_gap(1 - _SEARCHED).min()),
        jsw_at_share=dict(zip(JSW_FRACTIONS, measure_gap(np.array(JSW_FRACTIONS)).tolist(), strict=True)),
        joint_line_convergence_deg=float(np.rad2deg(np.arctan2(lean[1], lean[0]))),
    )
