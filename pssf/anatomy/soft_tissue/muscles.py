"""Muscles of a right knee as solids within the fascia, and the fat that fills the remaining volume."""

import numpy as np
from manifold3d import Manifold, OpType
from scipy.interpolate import PchipInterpolator

from ...core.checks import Array
from ...data.anatomy.soft_tissue_tables import DeepFat, MuscleShape
from ..meshing.solids import loft_column

# Largest distance between the rings of a muscle, in mm.
_STEP_MM = 12.0
# Number of points per ring of a muscle.
_COUNT = 20
# Length of the rounded end of a muscle at template size, in mm.
_END_ROUNDING_MM = 14.0
# Exponent of the superellipse that describes the limb cross-section.
FASCIA_POWER = 2.25
# Exponent of the superellipse that describes a muscle cross-section.
_POWER = 2.2


def build_intermuscular_fat(
    muscles: tuple[MuscleShape, ...], table: DeepFat, fascia: Array, levels: Array, scale: float
) -> Manifold:
    """Build the fat within the fascia: the volume outside the muscles, before bones and joint tissues are subtracted.

    Parameters
    ----------
    muscles : tuple of MuscleShape
        Sections of the template muscles.
    table : DeepFat
        Thickness of the fascia and of the tissue that covers bones and tendons, in mm.
    fascia : (n, 5) float64 array, mm
        Sections of the fascia: z, half ML, half AP, centre y and centre x, in mm, in the order of increasing z.
    levels : (k,) float64 array, mm
        Heights of the rings of the fascia, in mm. The fat needs the same ring heights, because otherwise it could
        protrude from the fascia.
    scale : float
        Size of the bones relative to the template. The heights of the muscles are multiplied by this scale.

    Returns
    -------
    Manifold
        Solid of the fat and all other tissue except muscle, in the frame of the straight leg, in mm.
    """
    within = fascia - np.array([0.0, table.fascia_mm, table.fascia_mm, 0.0, 0.0])
    whole = loft_column(within, np.zeros_like, levels[1:-1], "fat within the fascia", power=FASCIA_POWER, count=40)
    bodies = [_build_muscle(part, fascia, scale) for part in muscles]
    return Manifold.batch_boolean([whole, *bodies], OpType.Subtract)


def _build_muscle(part: MuscleShape, fascia: Array, scale: float) -> Manifold:
    """Build a muscle from sections whose sizes and centre offsets are fractions of the fascia semi-axes."""
    rows = np.array(sorted(part.sections))
    rows[:, 0] *= scale
    heights, rounding = _space_muscle_rings(rows[0, 0], rows[-1, 0], _END_ROUNDING_MM * scale)
    half_u, half_v, v, u = PchipInterpolator(rows[:, 0], rows[:, 1:])(heights).T
    half_x, half_y, y, x = (np.interp(heights, fascia[:, 0], fascia[:, k]) for k in range(1, 5))
    halves = (rounding * half_u * half_x, rounding * half_v * half_y)
    sections = np.column_stack((heights, *halves, y + v * half_y, x + u * half_x))
    return loft_column(sections, np.zeros_like, heights, part.name, power=_POWER, count=_COUNT)


def _space_muscle_rings(low: float, high: float, end_mm: float) -> tuple[Array, Array]:
    """Return the heights (k,) of the rings of a muscle, in mm, and the factors (k,) that narrow the rings.

    At both ends, the rings are closer together, and the factor follows an ellipse.
    """
    ends = np.array([0.0, 0.05, 0.2, 0.5, 1.0]) * end_mm
    between = np.linspace(low + end_mm, high - end_mm, max(2, int((high - low - 2 * end_mm) / _STEP_MM) + 1))
    heights = np.concatenate((low + ends, between[1:-1], high - ends[::-1]))
    depth = np.minimum(np.minimum(heights - low, high - heights) / end_mm, 1.0)
    return heights, np.sqrt(depth * (2.0 - depth))
