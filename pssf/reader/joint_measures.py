"""Joint space widths, plateau width and joint-line convergence from the sixteen contour landmarks of a radiograph.

The joint space is the gap between the two lines through the landmarks of femur and tibia, as in the statistics of
annotated radiographs (``data/landmarks.toml``).
"""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array, InputError
from ..core.label_names import CONTOUR_LANDMARKS, FEMORAL_LANDMARKS, JSW_FRACTIONS, TIBIAL_LANDMARKS

# Positions at which the smallest joint space is searched for: distances from the femoral edge of the compartment, as
# fractions of the femoral width (Tiulpin et al. 2019, as in `data/landmarks.toml`).
GAP_FRACTIONS = np.linspace(0.1, 0.3, 81)
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
    shares, widths = normalise_to_plateau(np.column_stack((landmarks_px[:, 1] * medial, -landmarks_px[:, 0]))[None])
    spaces = compute_gaps(shares[0], "medial", np.array(JSW_FRACTIONS))
    return JointMeasures(
        plateau_width_px=float(widths[0]),
        medial_jsw_share=float(compute_gaps(shares[0], "medial", GAP_FRACTIONS).min()),
        lateral_jsw_share=float(compute_gaps(shares[0], "lateral", GAP_FRACTIONS).min()),
        jsw_at_share=dict(zip(JSW_FRACTIONS, spaces.tolist(), strict=True)),
        joint_line_convergence_deg=float(compute_convergence_deg(shares)[0]),
    )


def normalise_to_plateau(places_mm: Array) -> tuple[Array, Array]:
    """Express landmarks as fractions of the plateau width.

    Parameters
    ----------
    places_mm : (n, 16, 2) array
        Landmarks, x medial and y proximal, in mm.

    Returns
    -------
    shares : (n, 16, 2) array
        Landmarks as fractions of the plateau width.
    width : (n,) array
        Plateau width in mm.

    Raises
    ------
    InputError
        The plateau width of a knee is 0.
    """
    lateral, medial = (places_mm[:, CONTOUR_LANDMARKS.index(f"tibia_{side}_edge")] for side in ("lateral", "medial"))
    across = medial - lateral
    width = np.linalg.norm(across, axis=1)
    if not (width > 0).all():
        raise InputError(f"plateau width of landmarks must be above 0 mm, got {width.min():g} mm")
    along = across / width[:, None]
    axes = np.stack((along, np.column_stack((-along[:, 1], along[:, 0]))), axis=2)
    shares = (places_mm - ((lateral + medial) / 2)[:, None]) @ axes / width[:, None, None]
    return shares, width


def compute_gaps(shares: Array, side: str, fractions: Array) -> Array:
    """Compute joint gaps at distances from the femoral edge of a compartment.

    Parameters
    ----------
    shares : (16, 2) array
        Landmarks, x medial and y proximal, dimensionless fractions of the plateau width.
    side : {"medial", "lateral"}
        Compartment.
    fractions : (k,) array
        Distances from the femoral edge of the compartment, dimensionless fractions of the femoral width.

    Returns
    -------
    (k,) array
        Gaps, as fractions of the plateau width.
    """
    femur, tibia = shares[_FEMUR], shares[_TIBIA]
    width = femur[-1, 0] - femur[0, 0]
    x = femur[-1, 0] - fractions * width if side == "medial" else femur[0, 0] + fractions * width
    return np.interp(x, *femur.T) - np.interp(x, *tibia.T)


def compute_convergence_deg(shares: Array) -> Array:
    """Compute the angle between the line through the condyles and the line through the plateau edges.

    Parameters
    ----------
    shares : (n, 16, 2) array
        Landmarks, x medial and y proximal, dimensionless fractions of the plateau width.

    Returns
    -------
    (n,) array
        Angles, in degrees; positive if the joint opens medially.
    """
    lateral, medial = (shares[:, CONTOUR_LANDMARKS.index(f"femur_{side}_condyle")] for side in ("lateral", "medial"))
    across = medial - lateral
    return np.rad2deg(np.arctan2(across[:, 1], across[:, 0]))
