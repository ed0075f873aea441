"""Muscles of a right knee as bodies within the fascia, and the fat that fills what they leave."""

import numpy as np
from manifold3d import Manifold, OpType
from scipy.interpolate import PchipInterpolator

from ..core.checks import Array
from ..data.soft import DeepFat, MuscleShape
from .solids import column

_STEP_MM, _COUNT = 12.0, 20
# By which a muscle's end is round.
_END_MM = 14.0
# Of the superellipses that sections of the limb and of a muscle are.
FASCIA_POWER, _POWER = 2.25, 2.2


def intermuscular_fat(
    muscles: tuple[MuscleShape, ...], table: DeepFat, fascia: Array, levels: Array, scale: float
) -> Manifold:
    """All fat within the fascia: what muscles leave, before bones and the joint are taken out of it.

    fascia  (n, 5)  z, half ML, half AP, centre y, centre x of the fascia, rising in z, mm
    levels  (k,)    heights, mm, of the rings that the fascia is drawn through; with others the fat might leave it
    scale   of the bones, which muscles follow in height
    """
    within = fascia - np.array([0.0, table.fascia_mm, table.fascia_mm, 0.0, 0.0])
    whole = column(within, np.zeros_like, levels[1:-1], "fat within the fascia", power=FASCIA_POWER, count=40)
    bodies = [_body(part, fascia, scale) for part in muscles]
    return Manifold.batch_boolean([whole, *bodies], OpType.Subtract)


def _body(part: MuscleShape, fascia: Array, scale: float) -> Manifold:
    """A muscle, whose sections are given in shares of the fascia's half axes about its centre."""
    rows = np.array(sorted(part.sections))
    rows[:, 0] *= scale
    heights, rounding = _levels(rows[0, 0], rows[-1, 0], _END_MM * scale)
    half_u, half_v, v, u = PchipInterpolator(rows[:, 0], rows[:, 1:])(heights).T
    half_x, half_y, y, x = (np.interp(heights, fascia[:, 0], fascia[:, k]) for k in range(1, 5))
    halves = (rounding * half_u * half_x, rounding * half_v * half_y)
    sections = np.column_stack((heights, *halves, y + v * half_y, x + u * half_x))
    return column(sections, np.zeros_like, heights, part.name, power=_POWER, count=_COUNT)


def _levels(low: float, high: float, end_mm: float) -> tuple[Array, Array]:
    """(k,), (k,)  heights of a muscle's rings, closer at its ends, and what narrows it there, like an ellipse."""
    ends = np.array([0.0, 0.05, 0.2, 0.5, 1.0]) * end_mm
    between = np.linspace(low + end_mm, high - end_mm, max(2, int((high - low - 2 * end_mm) / _STEP_MM) + 1))
    heights = np.concatenate((low + ends, between[1:-1], high - ends[::-1]))
    depth = np.minimum(np.minimum(heights - low, high - heights) / end_mm, 1.0)
    return heights, np.sqrt(depth * (2.0 - depth))
