"""Measure features of the cortex and the physeal scar on radiographs."""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.stats import median_abs_deviation

from ...core.checks import Array
from .film_normalisation import PITCH_MM, joint_centre_px
from .outline_features import Features

# Bone edges: direction from the midline (+1 medial, -1 lateral) and range of heights above the joint, in mm.
_SIDE_BANDS = {
    "medial_tibia": (1, -24.0, -12.0),
    "lateral_tibia": (-1, -20.0, -8.0),
    "medial_condyle": (1, 8.0, 20.0),
    "lateral_condyle": (-1, 8.0, 20.0),
    "medial_epicondyle": (1, 20.0, 30.0),
}
# Range of distances from the midline in which a bone edge is searched for, in mm.
_SOUGHT_MM = (24.0, 43.2)
# Length of the profile outside the bone edge, in mm.
_OUT_MM = 2.6
# Length of the profile inside the bone edge, in mm.
_IN_MM = 12.4
# Sampling step of the profile, in mm.
_STEP_MM = 0.2
# Depth range of soft tissue, in mm; depth is measured inwards from the steepest point of the profile.
_OUTSIDE_MM = (-2.5, -1.4)
# Depth range of bone, in mm inwards from the steepest point of the profile.
_INSIDE_MM = (6.0, 12.0)
# Depths at which the profile is reported, in mm inwards from the steepest point.
_TOLD_MM = (0.0, 0.6, 1.2, 2.1, 3.3)
# Minimum number of rows with a visible bone edge for which a profile is reported.
_LEAST_ROWS = 8
# Minimum grey-value difference between bone and soft tissue, as a fraction of the grey range of the image.
_LEAST_RISE = 0.15
# Range of heights above the joint in which the physeal scar of each bone is searched for, in mm.
_SCARS = {"femur": (14.0, 34.0), "tibia": (-30.0, -10.0)}
# Range of distances from the midline in which the physeal scar is searched for, in mm.
_ASIDE_MM = (15.0, 30.0)
# Width of the image strips over which line strength is averaged, in mm.
_WIDE_MM = 5.0
# Standard deviation of the Gaussian line filter across the line, in mm.
_THIN_MM = 0.7
# Standard deviation of the Gaussian line filter along the line, in mm.
_LONG_MM = 2.0


def measure_edges(field: Array) -> Features:
    """Measure grey profiles across the medial and lateral bone edges, and the strength of physeal lines.

    In a profile, soft tissue is 0 and bone at a depth of 6 to 12 mm is 1. Line strength is divided by the spread of the
    line-filter response.

    Parameters
    ----------
    field : (rows, cols) array, grey
        Radiograph in normalised geometry, with original display values.

    Returns
    -------
    dict of str to float
        Features keyed by name; the profile of an invisible bone edge is omitted.
    """
    values: Features = {}
    for name, (way, low_mm, high_mm) in _SIDE_BANDS.items():
        depth, profile = _measure_edge_profile(field, way, low_mm, high_mm)
        values |= {f"{name}_{mm:g}_mm": float(np.interp(mm, depth, profile)) for mm in _TOLD_MM if len(profile)}
    ridges = -gaussian_filter1d(
        gaussian_filter1d(field, _LONG_MM / PITCH_MM, axis=1), _THIN_MM / PITCH_MM, axis=0, order=2
    )
    for bone, (low_mm, high_mm) in _SCARS.items():
        band = ridges[_rows_above_joint(low_mm, high_mm)]
        values |= {
            f"{side}_{bone}_line": _measure_strongest_line(band, way) for side, way in (("medial", 1), ("lateral", -1))
        }
    return values


def _measure_edge_profile(field: Array, direction: int, low_mm: float, high_mm: float) -> tuple[Array, Array]:
    """Measure the median grey profile across a bone edge, with all rows aligned at the steepest point.

    Return depths (k,) in mm and the profile (k,), which is empty if no bone edge is visible.
    """
    depth = np.arange(-_OUT_MM, _IN_MM, _STEP_MM)
    sought, places = np.arange(*_SOUGHT_MM, _STEP_MM), (np.arange(field.shape[1]) - joint_centre_px()[1]) * PITCH_MM
    rows = []
    for row in field[_rows_above_joint(low_mm, high_mm), ::direction]:
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


def _measure_strongest_line(band: Array, direction: int) -> float:
    """Measure the strongest line-filter response in the medial (+1) or lateral (-1) half, divided by the spread."""
    middle, wide = joint_centre_px()[1], round(_WIDE_MM / PITCH_MM)
    within = band[:, np.abs(np.arange(band.shape[1]) - middle) * PITCH_MM < 36.0]
    usual, spread = np.median(within), median_abs_deviation(within, axis=None, scale="normal")
    starts = np.arange(_ASIDE_MM[0], _ASIDE_MM[1], _WIDE_MM) / PITCH_MM
    columns = [middle + direction * (round(start) + np.arange(wide)) for start in starts]
    strongest = max(band[:, one].mean(axis=1).max() for one in columns)
    return float((strongest - usual) / spread) if spread > 0 else float("nan")


def _rows_above_joint(low_mm: float, high_mm: float) -> slice:
    """Select the image rows between two heights above the joint, in mm."""
    return slice(*(joint_centre_px()[0] - round(mm / PITCH_MM) for mm in (high_mm, low_mm)))
