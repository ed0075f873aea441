"""Cortices and physeal scars of a film: brightness across the sides of the bones, and lines that cross them."""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.stats import median_abs_deviation

from ..core.checks import Array
from .form import PITCH_MM, joint_pixel
from .shape_features import Features

# Name: which way from the middle, from and to so far above the joint, mm.
_SIDES = {
    "medial_tibia": (1, -24.0, -12.0),
    "lateral_tibia": (-1, -20.0, -8.0),
    "medial_condyle": (1, 8.0, 20.0),
    "lateral_condyle": (-1, 8.0, 20.0),
    "medial_epicondyle": (1, 20.0, 30.0),
}
# A side is sought so far from the middle; about it the profile is told so far outwards and inwards.
_SOUGHT_MM, _OUT_MM, _IN_MM, _STEP_MM = (24.0, 43.2), 2.6, 12.4, 0.2
# Outside, inside, and where the profile is told, mm inwards of where it is steepest.
_OUTSIDE_MM, _INSIDE_MM, _TOLD_MM = (-2.5, -1.4), (6.0, 12.0), (0.0, 0.6, 1.2, 2.1, 3.3)
_LEAST_ROWS, _LEAST_RISE = 8, 0.15
# Where scars are: of the bone, above the joint; from and to so far from the middle; columns that are taken as one.
_SCARS, _ASIDE_MM, _WIDE_MM = {"femur": (14.0, 34.0), "tibia": (-30.0, -10.0)}, (15.0, 30.0), 5.0
# Of a line: half its thickness and its length, as deviations of Gaussians.
_THIN_MM, _LONG_MM = 0.7, 2.0


def edge_features(field: Array) -> Features:
    """Brightness across each side, soft tissue 0 and bone 6 to 12 mm in 1; how far lines rise above the texture.

    field  (rows, cols) grey, a display value, in the geometry of the standard form
    """
    values: Features = {}
    for name, (way, low_mm, high_mm) in _SIDES.items():
        depth, profile = _across(field, way, low_mm, high_mm)
        values |= {f"{name}_{mm:g}_mm": float(np.interp(mm, depth, profile)) for mm in _TOLD_MM if len(profile)}
    ridges = -gaussian_filter1d(
        gaussian_filter1d(field, _LONG_MM / PITCH_MM, axis=1), _THIN_MM / PITCH_MM, axis=0, order=2
    )
    for bone, (low_mm, high_mm) in _SCARS.items():
        band = ridges[_rows(low_mm, high_mm)]
        values |= {f"{side}_{bone}_line": _line(band, way) for side, way in (("medial", 1), ("lateral", -1))}
    return values


def _across(field: Array, way: int, low_mm: float, high_mm: float) -> tuple[Array, Array]:
    """Depths (k,) and the median of the rows' profiles there (k,), about where each row is steepest; or nothing."""
    depth = np.arange(-_OUT_MM, _IN_MM, _STEP_MM)
    sought, places = np.arange(*_SOUGHT_MM, _STEP_MM), (np.arange(field.shape[1]) - joint_pixel()[1]) * PITCH_MM
    rows = []
    for row in field[_rows(low_mm, high_mm), ::way]:
        fall = -np.gradient(gaussian_filter1d(np.interp(sought, places, row), 1.0 / _STEP_MM))
        steepest = int(fall.argmax())
        if 0 < steepest < len(sought) - 1 and sought[steepest] + _OUT_MM <= places[-1]:
            rows.append(np.interp(sought[steepest] - depth, places, row))
    if len(rows) < _LEAST_ROWS:
        return depth, np.empty(0)
    profile = np.median(rows, axis=0)
    outside, inside = (profile[(depth > low) & (depth < high)].mean() for low, high in (_OUTSIDE_MM, _INSIDE_MM))
    if inside - outside < _LEAST_RISE * np.ptp(np.percentile(field, [1, 99])):
        return depth, np.empty(0)
    return depth, (profile - outside) / (inside - outside)


def _line(band: Array, way: int) -> float:
    """The strongest line on a side of a band of ridges, over the spread of these."""
    middle, wide = joint_pixel()[1], round(_WIDE_MM / PITCH_MM)
    within = band[:, np.abs(np.arange(band.shape[1]) - middle) * PITCH_MM < 36.0]
    usual, spread = np.median(within), median_abs_deviation(within, axis=None, scale="normal")
    starts = np.arange(_ASIDE_MM[0], _ASIDE_MM[1], _WIDE_MM) / PITCH_MM
    columns = [middle + way * (round(start) + np.arange(wide)) for start in starts]
    strongest = max(band[:, one].mean(axis=1).max() for one in columns)
    return float((strongest - usual) / spread) if spread > 0 else float("nan")


def _rows(low_mm: float, high_mm: float) -> slice:
    """Rows from and to so far above the joint."""
    return slice(*(joint_pixel()[0] - round(mm / PITCH_MM) for mm in (high_mm, low_mm)))
