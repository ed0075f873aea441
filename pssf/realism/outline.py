"""Outlines of femur and tibia on a film in standard form: paths of steepest grey, found by dynamic programming."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter

from ..core.checks import Array
from ..core.compiled import kernel
from .form import PITCH_MM, PLATEAU_MM, joint_pixel

_BLUR_PX = 1.2
# Contrast is taken relative to what it is within some 4 and 6 mm: films differ in tone from bone to bone.
_COARSE_PX, _LOCAL_PX = 8.0, 12.0
_STEEPEST = 3.0  # what is steeper counts no more
_BEND = 0.02  # cost of a step of one row a column; it grows with the power 1.5 of the step
_JOINT_STEPS, _SIDE_STEPS = 4, 2
# Where bone lies on bone no edge tells where the femur ends, and one within it might be taken: each row of the joint
# space costs as much as it is not dark. Not about the middle, over so many mm and then less, where the notch is.
_ROW, _NOT_DARK = 0.1, 0.6
_NOTCH_MM, _FADING_MM = 10.0, 6.0
# A spine's outline is faint, and edges within it are not: each row costs that is brighter than the notch above it.
# About the middle, and less over so many mm towards the end of the eminence.
_ROW_PASSED, _BRIGHTER, _BRIGHTEST = 0.03, 0.1, 2.0
_SPINES_MM, _SPINES_FADING_MM = 21.0, 14.0
_NEVER = 10.0
# A side is not sought far beyond these shares of half the plateau's width: fibula, fat and skin have edges too.
# So many mm beyond, a place costs so much more; it grows with the square.
_TIBIA_WITHIN, _FEMUR_WITHIN = 1.08, 1.15
_BEYOND_MM, _BEYOND = 8.0, 0.3
_REACH_MM = 36.0  # of the joint's contours to either side of its middle
_SIDES_MM = (3.0, 24.0)  # heights below (tibia) and above (femur) the joint line at which the bones' sides are sought
_MISSED_MM = 16.0
# No eminence stands so far above the middle of the joint: medial spines are .143 (.016) of the plateau's width above
# its edges (Tiulpin et al. 2019), which lie some 3 mm below that middle. So much does a millimetre more cost.
_TALLEST_MM, _TOO_TALL = 12.0, 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """Contours of a joint in pixels of the standard form; lateral is left.

    columns        (n,)  columns of the two joint contours
    femur, tibia   (n,)  rows of the femur's lower and the tibia's upper contour
    tibia_rows     (m,)  rows at which the tibia's sides are known, from the joint downwards
    tibia_sides    (m, 2)  columns of its lateral and medial side
    femur_rows     (m,)  the same of the femur, from the joint upwards
    femur_sides    (m, 2)
    """

    columns: Array
    femur: Array
    tibia: Array
    tibia_rows: Array
    tibia_sides: Array
    femur_rows: Array
    femur_sides: Array


def trace_outline(film: Array, plateau_mm: float = PLATEAU_MM) -> Outline:
    """Contours of the bones of a film.

    film        (rows, cols)  grey, standard form
    plateau_mm  about how wide the plateau is there
    """
    row, col = joint_pixel()
    rise, across, tone, grey = _steepness(film)
    reach = round(_REACH_MM / PITCH_MM)
    columns = np.arange(col - reach, col + reach + 1)
    rows, x_mm = np.arange(len(film))[:, None], np.abs(columns - col) * PITCH_MM
    # Downwards: darker where the femur ends, brighter at the tibia; neither is sought far from the joint line.
    away = (rows - row) * PITCH_MM / _MISSED_MM
    too_tall = _TOO_TALL * np.maximum((row - rows) * PITCH_MM - _TALLEST_MM, 0.0)
    brighter = -0.6 * np.clip(rise, 0, _STEEPEST)[:, columns] + 0.15 * away**2 + too_tall
    darker = -0.6 * np.clip(-rise, 0, _STEEPEST)[:, columns] + 0.1 * (away + 0.5) ** 2
    tibia = cheapest_path(brighter, _JOINT_STEPS - 1)
    femur = cheapest_path(darker + _bone_between(tone[:, columns], tibia, x_mm), _JOINT_STEPS)
    tibia = cheapest_path(brighter + _bone_passed(grey[:, columns], femur, x_mm), _JOINT_STEPS - 1)
    half_mm = plateau_mm / 2
    below, tibia_sides = _sides(across, int(np.median(tibia)), +1, _TIBIA_WITHIN * half_mm)
    above, femur_sides = _sides(across, int(np.median(femur)), -1, _FEMUR_WITHIN * half_mm)
    return Outline(
        columns=columns.astype(float), femur=femur.astype(float), tibia=tibia.astype(float),
        tibia_rows=below, tibia_sides=tibia_sides, femur_rows=above, femur_sides=femur_sides,
    )  # fmt: skip


def _bone_between(tone: Array, tibia: NDArray[np.int64], x_mm: Array) -> Array:
    """(rows, cols)  what it costs the femur to end so far above the tibia: rows between that are not dark

    tone   (rows, cols)  of `_steepness`
    tibia  (cols,)  rows of its contour
    x_mm   (cols,)  from the middle, either way
    """
    rows = np.arange(len(tone))[:, None]
    space = np.where(rows < tibia, np.clip(tone, -1.0, 1.0) + _NOT_DARK, 0.0)
    beside = np.clip((x_mm - _NOTCH_MM) / _FADING_MM, 0.0, 1.0)
    return np.where(rows < tibia, _ROW * beside * np.cumsum(space[::-1], axis=0)[::-1], _NEVER)


def _bone_passed(grey: Array, femur: NDArray[np.int64], x_mm: Array) -> Array:
    """(rows, cols)  what it costs the tibia to begin so far below the femur: rows between that are brighter than the
    darkest above them, as a spine is; arguments as above

    grey  (rows, cols)  of `_steepness`; its detail alone is brighter in the middle of a dark notch than at its edge
    """
    rows = np.arange(len(grey))[:, None]
    soft = gaussian_filter(grey, 1.0)
    darkest = np.minimum.accumulate(np.where(rows > femur, soft, np.inf), axis=0)
    passed = np.where(rows > femur + 1, np.clip(soft - darkest - _BRIGHTER, 0.0, _BRIGHTEST), 0.0)
    about = np.clip((_SPINES_MM - x_mm) / _SPINES_FADING_MM, 0.0, 1.0)
    return np.where(rows > femur, _ROW_PASSED * about * (np.cumsum(passed, axis=0) - passed), _NEVER)


def cheapest_path(cost: Array, step: int) -> NDArray[np.int64]:
    """(cols,) row in every column of the path of least cost from the first column to the last.

    cost  (rows, cols)  dimensionless
    step  rows that a path may move from one column to the next
    """
    return _path(np.ascontiguousarray(cost, np.float64), _BEND * np.arange(step + 1.0) ** 1.5)


@kernel()
def _path(cost: Array, price: Array) -> NDArray[np.int64]:
    rows, cols = cost.shape
    step = len(price) - 1
    origin = np.empty((cols, rows), np.int64)
    total = cost[:, 0].copy()
    for at in range(1, cols):
        before = total.copy()
        for row in range(rows):
            least = np.inf
            for source in range(min(row + step, rows - 1), max(row - step, 0) - 1, -1):
                way = before[source] + price[abs(row - source)]
                if way < least:
                    least, origin[at, row] = way, source
            total[row] = least + cost[row, at]
    path = np.empty(cols, np.int64)
    path[-1] = total.argmin()
    for at in range(cols - 1, 0, -1):
        path[at - 1] = origin[at, path[at]]
    return path


def _steepness(film: Array) -> tuple[Array, Array, Array, Array]:
    """(rows, cols) slope of the grey downwards and to the right, its detail and itself, over the contrast near by."""
    detail = film - gaussian_filter(film, _COARSE_PX)
    local = np.sqrt(gaussian_filter(detail**2, _LOCAL_PX)) + 0.25
    # Beside a limb all is faint, and its own contrast would make of a fat line as much as of a bone's side.
    steady = np.sqrt(local**2 + (detail**2).mean())
    down = gaussian_filter(film, _BLUR_PX, order=(1, 0)) / local
    right = gaussian_filter(film, _BLUR_PX, order=(0, 1)) / (steady * np.median(local) / np.median(steady))
    return down, right, detail / local, film / local


def _sides(across: Array, row: int, way: int, within_mm: float) -> tuple[Array, Array]:
    """Rows, and the columns of a bone's lateral and medial side there; `way` +1 goes down from the joint, -1 up.

    within_mm  of the middle, beyond which a side is less and less likely
    """
    near, far = (round(length / PITCH_MM) for length in _SIDES_MM)
    rows = np.clip(row + way * np.arange(near, far + 1), 0, len(across) - 1)
    _, middle = joint_pixel()
    inner = round(20.0 / PITCH_MM)  # the shaft is wider than this
    beyond_mm = np.maximum(np.abs(np.arange(across.shape[1]) - middle) * PITCH_MM - within_mm, 0.0)
    unlikely, steep = _BEYOND * (beyond_mm / _BEYOND_MM) ** 2, across[rows]
    costs = [unlikely - np.clip(sign * steep, 0, _STEEPEST) for sign in (1, -1)]
    lateral = cheapest_path(costs[0][:, : middle - inner].T, _SIDE_STEPS)
    medial = cheapest_path(costs[1][:, middle + inner :].T, _SIDE_STEPS) + middle + inner
    sides = median_filter(np.column_stack((lateral, medial)).astype(float), size=(3, 1))
    return rows.astype(float), sides
