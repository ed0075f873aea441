"""Trace the contours of femur and tibia on a normalised radiograph by dynamic programming."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter

from ...core.checks import Array
from ...core.numba_kernel import kernel
from .film_normalisation import PITCH_MM, PLATEAU_MM, joint_centre_px

# Standard deviation of the Gaussian derivative filter for gradients, in px.
_BLUR_PX = 1.2
# Grey detail is the image minus a Gaussian blur with this standard deviation, in px. Gradients are divided by the local
# contrast within about 4 to 6 mm, because grey values differ between bones.
_COARSE_PX = 8.0
# Standard deviation of the Gaussian that averages the squared grey detail to local contrast, in px.
_LOCAL_PX = 12.0
# Upper limit to which relative gradients are clipped, dimensionless.
_MAX_STEEPNESS = 3.0
# Cost of a contour step of one row per column, dimensionless; the cost is proportional to the step to the power 1.5.
_BEND_COST = 0.02
# Maximum step of a joint contour, in rows per column.
_JOINT_STEPS = 4
# Maximum step of a side contour, in columns per row.
_SIDE_STEPS = 2
# Cost per row between the femoral and tibial contours, dimensionless. The cost increases with brightness, so that no
# edge inside the bone is traced where femur and tibia overlap and the femoral contour has no edge.
_ROW = 0.1
# Offset that is added to the grey detail of a row to compute the row cost, dimensionless.
_NOT_DARK = 0.6
# Distance from the midline up to which the row cost is 0 because of the intercondylar notch, in mm.
_NOTCH_MM = 10.0
# Distance from the notch over which the row cost increases to its full value, in mm.
_FADING_MM = 6.0
# Cost of a tibial contour per row and unit of brightness, dimensionless. A row that is brighter than the notch above
# adds this cost, because the contour of a tibial spine is faint and edges inside the spine are strong.
_ROW_PASSED = 0.03
# Brightness difference from the darkest row above, beyond which a row adds a cost, dimensionless.
_BRIGHTER = 0.1
# Upper limit to which brightness differences are clipped, dimensionless.
_BRIGHTEST = 2.0
# Distance from the midline beyond which the spine cost is 0, in mm: half the width of the eminence.
_SPINES_MM = 21.0
# Distance over which the spine cost decreases to 0, in mm.
_SPINES_FADING_MM = 14.0
# Cost of a femoral contour below the tibial contour, or of a tibial contour above the femoral contour, dimensionless.
_FORBIDDEN_COST = 10.0
# Distance from the midline up to which the tibial side contours have no extra cost, in half plateau widths. Side
# contours are searched for only near the plateau edges, because fibula, fat and skin also have edges.
_TIBIA_WITHIN = 1.08
# Distance from the midline up to which the femoral side contours have no extra cost, in half plateau widths.
_FEMUR_WITHIN = 1.15
# Distance beyond the limits `_TIBIA_WITHIN` and `_FEMUR_WITHIN` at which the extra cost is `_BEYOND`, in mm.
_BEYOND_MM = 8.0
# Extra cost at the distance `_BEYOND_MM`, dimensionless; the cost is proportional to the square of the distance.
_BEYOND = 0.3
# Distance from the midline up to which joint contours are traced, in mm.
_CONTOUR_REACH_MM = 36.0
# Range of distances below (tibia) and above (femur) the joint line in which side contours are traced, in mm.
_SIDE_HEIGHTS_MM = (3.0, 24.0)
# Distance from the joint line that scales the quadratic cost of a joint contour, in mm.
_SEARCH_SCALE_MM = 16.0
# Maximum height of the eminence above the joint centre, in mm. Medial spines are 0.143 (SD 0.016) plateau widths above
# the plateau edges (Tiulpin et al. 2019). The edges are about 3 mm below the joint centre.
_TALLEST_MM = 12.0
# Cost of a tibial contour per mm above the maximum height of the eminence, dimensionless.
_TOO_TALL = 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """Bone contours of a knee, in pixels of the normalised radiograph; lateral is left.

    Attributes
    ----------
    columns : (n,) array
        Columns of the two joint contours, in px.
    femur : (n,) array
        Rows of the distal femoral contour, in px.
    tibia : (n,) array
        Rows of the proximal tibial contour, in px.
    tibia_rows : (m,) array
        Rows of the medial and lateral tibial contours, from the joint downwards, in px.
    tibia_sides : (m, 2) array
        Columns of the lateral and the medial tibial contour, in px.
    femur_rows : (m,) array
        Rows of the medial and lateral femoral contours, from the joint upwards, in px.
    femur_sides : (m, 2) array
        Columns of the lateral and the medial femoral contour, in px.
    """

    columns: Array
    femur: Array
    tibia: Array
    tibia_rows: Array
    tibia_sides: Array
    femur_rows: Array
    femur_sides: Array


def trace_outline(film: Array, plateau_mm: float = PLATEAU_MM) -> Outline:
    """Trace the bone contours of a normalised radiograph.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Normalised radiograph.
    plateau_mm : float, default PLATEAU_MM
        Approximate plateau width on the radiograph, in mm.

    Returns
    -------
    Outline
        Contours of femur and tibia.
    """
    row, col = joint_centre_px()
    rise, across, tone, grey = _compute_gradients(film)
    reach = round(_CONTOUR_REACH_MM / PITCH_MM)
    columns = np.arange(col - reach, col + reach + 1)
    rows, x_mm = np.arange(len(film))[:, None], np.abs(columns - col) * PITCH_MM
    # From top to bottom, the grey value decreases at the distal femur and increases at the proximal tibia.
    away = (rows - row) * PITCH_MM / _SEARCH_SCALE_MM
    too_tall = _TOO_TALL * np.maximum((row - rows) * PITCH_MM - _TALLEST_MM, 0.0)
    brighter = -0.6 * np.clip(rise, 0, _MAX_STEEPNESS)[:, columns] + 0.15 * away**2 + too_tall
    darker = -0.6 * np.clip(-rise, 0, _MAX_STEEPNESS)[:, columns] + 0.1 * (away + 0.5) ** 2
    tibia = find_cheapest_path(brighter, _JOINT_STEPS - 1)
    femur = find_cheapest_path(darker + _compute_gap_cost(tone[:, columns], tibia, x_mm), _JOINT_STEPS)
    tibia = find_cheapest_path(brighter + _compute_passed_bone_cost(grey[:, columns], femur, x_mm), _JOINT_STEPS - 1)
    half_mm = plateau_mm / 2
    below, tibia_sides = _trace_sides(across, int(np.median(tibia)), +1, _TIBIA_WITHIN * half_mm)
    above, femur_sides = _trace_sides(across, int(np.median(femur)), -1, _FEMUR_WITHIN * half_mm)
    return Outline(
        columns=columns.astype(float), femur=femur.astype(float), tibia=tibia.astype(float),
        tibia_rows=below, tibia_sides=tibia_sides, femur_rows=above, femur_sides=femur_sides,
    )  # fmt: skip


def _compute_gap_cost(tone: Array, tibia: NDArray[np.int64], x_mm: Array) -> Array:
    """Compute the cost of a distal femoral contour from the bright rows between the contour and the tibia.

    `tone` is the grey detail from :func:`_compute_gradients`. `tibia` contains the (cols,) rows of the tibial contour.
    `x_mm` contains the (cols,) distances from the midline, in mm. The cost has shape (rows, cols).
    """
    rows = np.arange(len(tone))[:, None]
    space = np.where(rows < tibia, np.clip(tone, -1.0, 1.0) + _NOT_DARK, 0.0)
    beside = np.clip((x_mm - _NOTCH_MM) / _FADING_MM, 0.0, 1.0)
    return np.where(rows < tibia, _ROW * beside * np.cumsum(space[::-1], axis=0)[::-1], _FORBIDDEN_COST)


def _compute_passed_bone_cost(grey: Array, femur: NDArray[np.int64], x_mm: Array) -> Array:
    """Compute the cost of a proximal tibial contour from the bright rows between the femur and the contour.

    A row adds a cost if the row is brighter than the darkest row above, as in a tibial spine. `grey` is the grey value
    divided by local contrast. Grey detail is not used, because it overestimates the brightness in a dark notch. `femur`
    contains the (cols,) rows of the femoral contour. `x_mm` contains the (cols,) distances from the midline, in mm. The
    cost has shape (rows, cols).
    """
    rows = np.arange(len(grey))[:, None]
    soft = gaussian_filter(grey, 1.0)
    darkest = np.minimum.accumulate(np.where(rows > femur, soft, np.inf), axis=0)
    passed = np.where(rows > femur + 1, np.clip(soft - darkest - _BRIGHTER, 0.0, _BRIGHTEST), 0.0)
    about = np.clip((_SPINES_MM - x_mm) / _SPINES_FADING_MM, 0.0, 1.0)
    return np.where(rows > femur, _ROW_PASSED * about * (np.cumsum(passed, axis=0) - passed), _FORBIDDEN_COST)


def find_cheapest_path(cost: Array, max_step_px: int) -> NDArray[np.int64]:
    """Find the path with the least total cost from the first to the last column.

    Parameters
    ----------
    cost : (rows, cols) array, dimensionless
        Cost of each pixel.
    max_step_px : int
        Maximum row difference between neighbouring columns.

    Returns
    -------
    (cols,) int64 array
        Row of the path in each column.
    """
    return _solve_cheapest_path(
        np.ascontiguousarray(cost, np.float64), _BEND_COST * np.arange(max_step_px + 1.0) ** 1.5
    )


@kernel()
def _solve_cheapest_path(cost: Array, step_cost: Array) -> NDArray[np.int64]:
    """Find the cheapest path (cols,) by dynamic programming; `step_cost` is the cost of each row step."""
    rows, cols = cost.shape
    step = len(step_cost) - 1
    origin = np.empty((cols, rows), np.int64)
    total = cost[:, 0].copy()
    for at in range(1, cols):
        before = total.copy()
        for row in range(rows):
            least = np.inf
            for source in range(min(row + step, rows - 1), max(row - step, 0) - 1, -1):
                way = before[source] + step_cost[abs(row - source)]
                if way < least:
                    least, origin[at, row] = way, source
            total[row] = least + cost[row, at]
    path = np.empty(cols, np.int64)
    path[-1] = total.argmin()
    for at in range(cols - 1, 0, -1):
        path[at - 1] = origin[at, path[at]]
    return path


def _compute_gradients(film: Array) -> tuple[Array, Array, Array, Array]:
    """Compute vertical gradient, horizontal gradient, grey detail and grey value, each divided by local contrast."""
    detail = film - gaussian_filter(film, _COARSE_PX)
    local = np.sqrt(gaussian_filter(detail**2, _LOCAL_PX)) + 0.25
    # Local contrast is low near the skin. Division by local contrast alone would make fat edges as strong as bone
    # edges.
    steady = np.sqrt(local**2 + (detail**2).mean())
    down = gaussian_filter(film, _BLUR_PX, order=(1, 0)) / local
    right = gaussian_filter(film, _BLUR_PX, order=(0, 1)) / (steady * np.median(local) / np.median(steady))
    return down, right, detail / local, film / local


def _trace_sides(across: Array, row: int, direction: int, within_mm: float) -> tuple[Array, Array]:
    """Trace the lateral and medial contours of a bone; return rows (m,) and columns (m, 2) in px.

    `direction` is +1 downwards and -1 upwards from the joint. The cost increases beyond `within_mm` from the midline.
    """
    near, far = (round(length / PITCH_MM) for length in _SIDE_HEIGHTS_MM)
    rows = np.clip(row + direction * np.arange(near, far + 1), 0, len(across) - 1)
    _, middle = joint_centre_px()
    inner = round(20.0 / PITCH_MM)  # Femur and tibia extend more than 20 mm medially and laterally.
    beyond_mm = np.maximum(np.abs(np.arange(across.shape[1]) - middle) * PITCH_MM - within_mm, 0.0)
    unlikely, steep = _BEYOND * (beyond_mm / _BEYOND_MM) ** 2, across[rows]
    costs = [unlikely - np.clip(sign * steep, 0, _MAX_STEEPNESS) for sign in (1, -1)]
    lateral = find_cheapest_path(costs[0][:, : middle - inner].T, _SIDE_STEPS)
    medial = find_cheapest_path(costs[1][:, middle + inner :].T, _SIDE_STEPS) + middle + inner
    sides = median_filter(np.column_stack((lateral, medial)).astype(float), size=(3, 1))
    return rows.astype(float), sides
