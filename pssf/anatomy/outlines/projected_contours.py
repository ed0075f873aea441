"""Projected contours of femur and tibia and the joint space between them."""

from dataclasses import dataclass

import numpy as np

from ...core.checks import Array
from ...core.numba_kernel import kernel
from ...data.table_records import Pair
from ...geometry.mesh import Indices
from ...geometry.view import View, magnification, project_points

# Range in which JSW is measured, as fractions of half the tibial width. The range excludes the spines and the margins.
COMPARTMENT_RANGE = (0.36, 0.85)
# Smallest number of columns that are sampled per compartment.
_MIN_COLUMNS = 3
# Largest distance between sampled columns, in mm on the detector.
_MAX_STEP_MM = 0.15


@dataclass(frozen=True)
class Gap:
    """Joint space of one compartment on the detector, column by column.

    Attributes
    ----------
    columns_px : (n,) float64 array
        Sampled columns within the compartment, in pixels. The columns are fractional if the pixels are coarse.
    femur_px : (n,) float64 array
        Row of the lower femoral contour in each column, in pixels.
    tibia_px : (n,) float64 array
        Row of the upper tibial contour, or of the floor of the plateau, in each column, in pixels.
    mm_per_pixel : float
        Pixel size scaled to the joint plane, in mm per pixel.
    middle_col_px : float
        Column at the centre of the compartment, in pixels.
    """

    columns_px: Array
    femur_px: Array
    tibia_px: Array
    mm_per_pixel: float
    middle_col_px: float

    @property
    def jsw_mm(self) -> float:
        """Smallest vertical gap, in mm, scaled to the joint plane."""
        return float((self.tibia_px - self.femur_px).min() * self.mm_per_pixel)

    @property
    def narrowest_index(self) -> int:
        """Index of the column with the smallest gap."""
        return int((self.tibia_px - self.femur_px).argmin())

    def narrowest_px(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the femoral and tibial contour points at the smallest gap.

        Returns
        -------
        femur : tuple of float
            Row and column of the point on the femoral contour, in pixels.
        tibia : tuple of float
            Row and column of the point on the tibial contour, in pixels.
        """
        at = self.narrowest_index
        col = float(self.columns_px[at])
        return (float(self.femur_px[at]), col), (float(self.tibia_px[at]), col)

    def middle_px(self) -> tuple[float, float]:
        """Return the centre of the joint space at the central column of the compartment.

        Returns
        -------
        tuple of float
            Row and column, in pixels.
        """
        rows = (self.femur_px + self.tibia_px) / 2
        return (float(np.interp(self.middle_col_px, self.columns_px, rows)), self.middle_col_px)


def rotate_px(points_px: Array, view: View, angle_deg: float) -> Array:
    """Rotate points on the detector about the projected origin of the knee frame.

    Parameters
    ----------
    points_px : (n, 2) float64 array
        Row and column of each point, in pixels.
    view : View
        Source and detector.
    angle_deg : float
        Angle in degrees, clockwise on the image.

    Returns
    -------
    (n, 2) float64 array
        Row and column of each rotated point, in pixels.
    """
    middle = project_points(np.zeros((1, 3)), view)[0]
    row, col = (np.asarray(points_px) - middle).T
    sin, cos = np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))
    return np.column_stack((row * cos + col * sin, col * cos - row * sin)) + middle


def measure_gap(
    femur: tuple[Array, Indices],
    tibia: tuple[Array, Indices] | Array,
    view: View,
    side_sign: int,
    half_ml_mm: float,
    lean_deg: float = 0.0,
    range_fractions: Pair = COMPARTMENT_RANGE,
) -> Gap:
    """Measure the joint space of one compartment on the detector.

    Parameters
    ----------
    femur : tuple of (n, 3) float64 array, mm, and (m, 2) integer array
        Vertices and edges of the outer femur in the knee frame.
    tibia : tuple like `femur`, or (k, 2) float64 array, px
        Vertices and edges of the outer tibia, or a polyline that replaces its contour. The polyline contains the row
        and the column of each point, in the order of increasing columns.
    view : View
        Source and detector.
    side_sign : int
        +1 for the compartment at x > 0, -1 for the compartment at x < 0.
    half_ml_mm : float
        Half the mediolateral width of the tibial plateau, in mm.
    lean_deg : float, default 0.0
        Lean of the leg in the image, in degrees, clockwise positive. The lean is removed before rows and columns are
        measured.
    range_fractions : tuple of float, default (0.36, 0.85)
        Range in which the joint space is measured, as fractions of `half_ml_mm`.

    Returns
    -------
    Gap
        Joint space at each sampled column.
    """
    ends = np.array([[side_sign * f * half_ml_mm, 0.0, 0.0] for f in range_fractions])
    first, last = np.sort(project_points(ends, view)[:, 1])
    # The gap is measured on exact contours, so contours on a coarse detector are also sampled between its columns.
    finer = max(1, int(np.ceil(view.pixel_mm / _MAX_STEP_MM)), int(np.ceil(_MIN_COLUMNS / (last - first))))
    steps = np.arange(np.ceil(first * finer), np.floor(last * finer) + 1)
    columns = steps / finer

    def outline(bone: tuple[Array, Indices], lowest: float) -> Array:
        seen = rotate_px(project_points(bone[0], view), view, -lean_deg) * (1, finer)
        return compute_outline_rows(seen, bone[1], int(steps[0]), len(steps), lowest)

    if isinstance(tibia, tuple):
        upper = outline(tibia, -1.0)
    else:
        rows, cols = rotate_px(tibia, view, -lean_deg).T
        upper = np.interp(columns, cols, rows)
    scale_mm = view.pixel_mm / magnification(view)
    return Gap(columns, outline(femur, 1.0), upper, scale_mm, float(first + last) / 2)


def compute_outline_rows(points_px: Array, edges: Indices, first_column: int, count: int, outline_sign: float) -> Array:
    """Compute the outline of a projected mesh in consecutive columns.

    Parameters
    ----------
    points_px : (n, 2) float64 array
        Row and column of the projected vertices, in pixels.
    edges : (m, 2) integer array
        Vertex indices of the edges.
    first_column : int
        Index of the first column.
    count : int
        Number of columns.
    outline_sign : float
        +1 for the lower outline, -1 for the upper outline.

    Returns
    -------
    (count,) float64 array
        Row of the outline in each column, in pixels. It is infinite in columns that contain no mesh.
    """
    return (
        _walk_edges(np.ascontiguousarray(points_px), np.ascontiguousarray(edges), first_column, count, outline_sign)
        * outline_sign
    )


@kernel()
def _walk_edges(points: Array, edges: Indices, first: int, count: int, outline_sign: float) -> Array:
    """Return the largest ``outline_sign * row`` (count,) over all edges in each column.

    The outline of a polyhedron consists of its edges.
    """
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
            row = outline_sign * (row_a + share * (row_b - row_a))
            if row > best[column - first]:
                best[column - first] = row
    return best
