"""Projected contours of femur and tibia, and the joint space between them."""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array
from ..core.compiled import kernel
from ..data.records import Pair
from ..geometry.mesh import Indices
from ..geometry.view import View, magnification, project

# Fractions of the tibial half width between which the joint space is measured: clear of the spines and of the margins.
COMPARTMENT = (0.36, 0.85)
# Columns of a compartment that are sampled, at the least; and how far apart they are at most, mm on the detector.
_LEAST_COLUMNS = 3
_STEP_MM = 0.15


@dataclass(frozen=True)
class Gap:
    """Joint space of one compartment on the detector, column by column.

    columns_px     (n,)  columns within the compartment: whole ones, or parts of such as are too wide for it
    femur_px       (n,)  row of the femur's lower contour
    tibia_px       (n,)  row of the tibia's upper contour, or of the floor of its plateau
    scale_mm       joint-plane millimetres a pixel
    middle_col_px  half way across the compartment
    """

    columns_px: Array
    femur_px: Array
    tibia_px: Array
    scale_mm: float
    middle_col_px: float

    @property
    def jsw_mm(self) -> float:
        """Smallest vertical gap, scaled to the joint plane."""
        return float((self.tibia_px - self.femur_px).min() * self.scale_mm)

    @property
    def narrowest(self) -> int:
        """Index of the narrowest column."""
        return int((self.tibia_px - self.femur_px).argmin())

    def narrowest_px(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return (row, column) of the femur's and of the tibia's contour where the gap is smallest."""
        at = self.narrowest
        col = float(self.columns_px[at])
        return (float(self.femur_px[at]), col), (float(self.tibia_px[at]), col)

    def middle_px(self) -> tuple[float, float]:
        """(row, column) of the middle of the space, half way across the compartment."""
        rows = (self.femur_px + self.tibia_px) / 2
        return (float(np.interp(self.middle_col_px, self.columns_px, rows)), self.middle_col_px)


def turned_px(points_px: Array, view: View, angle_deg: float) -> Array:
    """(n, 2)  places on the detector turned about where the origin is seen, from columns' end towards rows' start

    points_px  (n, 2)  row, column
    """
    middle = project(np.zeros((1, 3)), view)[0]
    row, col = (np.asarray(points_px) - middle).T
    sin, cos = np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))
    return np.column_stack((row * cos + col * sin, col * cos - row * sin)) + middle


def measure_gap(
    femur: tuple[Array, Indices],
    tibia: tuple[Array, Indices] | Array,
    view: View,
    side_x: int,
    half_ml_mm: float,
    lean_deg: float = 0.0,
    between: Pair = COMPARTMENT,
) -> Gap:
    """The joint space of a compartment as a detector at `view` sees it.

    femur, tibia  vertices (n, 3) mm and edges (m, 2); or, taken for the tibia's contour, a line: (k, 2) row and column,
                  in the order of its columns
    side_x        +1 for the compartment at x > 0, -1 for the other
    half_ml_mm    half the medio-lateral width of the tibial plateau
    lean_deg      of the leg about y: rows and columns are told as if it had none
    between       fractions of the half width
    """
    ends = np.array([[side_x * f * half_ml_mm, 0.0, 0.0] for f in between])
    first, last = np.sort(project(ends, view)[:, 1])
    # The gap is that of the contours, whatever the pixel: a coarse detector is sampled between its columns.
    finer = max(1, int(np.ceil(view.pixel_mm / _STEP_MM)), int(np.ceil(_LEAST_COLUMNS / (last - first))))
    steps = np.arange(np.ceil(first * finer), np.floor(last * finer) + 1)
    columns = steps / finer

    def outline(bone: tuple[Array, Indices], lowest: float) -> Array:
        seen = turned_px(project(bone[0], view), view, -lean_deg) * (1, finer)
        return envelope(seen, bone[1], int(steps[0]), len(steps), lowest)

    if isinstance(tibia, tuple):
        upper = outline(tibia, -1.0)
    else:
        rows, cols = turned_px(tibia, view, -lean_deg).T
        upper = np.interp(columns, cols, rows)
    scale_mm = view.pixel_mm / magnification(view)
    return Gap(columns, outline(femur, 1.0), upper, scale_mm, float(first + last) / 2)


def envelope(points_px: Array, edges: Indices, first: int, count: int, lowest: float) -> Array:
    """(count,)  row of the outline of a projected mesh in columns from `first` on

    points_px  (n, 2)  its vertices
    edges      (m, 2)
    lowest     +1 for the lower outline, -1 for the upper one
    """
    return _walk_edges(np.ascontiguousarray(points_px), np.ascontiguousarray(edges), first, count, lowest) * lowest


@kernel()
def _walk_edges(points: Array, edges: Indices, first: int, count: int, lowest: float) -> Array:
    """(count,)  largest lowest*row of any edge at each column; the contour of a polyhedron runs along its edges"""
    best = np.full(count, -np.inf)
    for k in range(edges.shape[0]):
        row_a, col_a = points[edges[k, 0], 0], points[edges[k, 0], 1]
        row_b, col_b = points[edges[k, 1], 0], points[edges[k, 1], 1]
        if col_a > col_b:
            row_a, col_a, row_b, col_b = row_b, col_b, row_a, col_a
        start = max(int(np.ceil(col_a)), first)
        stop = min(int(np.floor(col_b)), first + count - 1)
        for column in range(start, stop + 1):
            share = (column - col_a) / (col_b - col_a) if col_b > col_a else 0.0
            row = lowest * (row_a + share * (row_b - row_a))
            if row > best[column - first]:
                best[column - first] = row
    return best
