"""Map of the error of the joint space against beam angle and positioning, for one knee or several knees."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ..anatomy import BuiltKnee, build
from ..core.checks import Array, InputError, require_choice
from ..core.processes.parallel_map import map_in_parallel
from ..model.knee import Knee
from ..model.protocol import Protocol

# Second axis of a map -> protocol field that is varied.
AXES = {
    "rotation": "rotation_deg",
    "flexion": "flexion_deg",
    "distance": "sod_mm",
    "centre_x": "centre_x_mm",
    "centre_z": "centre_z_mm",
}
# Error of the joint space that a map shows as a line, in mm: within the standard errors of repeated radiographs in the
# metatarsophalangeal view (0.08 to 0.16 mm; from memory).
ISO_LINE_MM = 0.13
# Distances from the best beam angle for which the error is summarised, in degrees.
_WITHIN_DEG = (1.0, 2.0)
MAP_COLUMNS = ["knee", "grade", "axis", "beam_angle_deg", "value", "medial_mm", "error_mm"]
SUMMARY_COLUMNS = ["knee", "grade", "best_angle_deg", "reference_mm", "nominal_error_mm", "within_1_mm", "within_2_mm"]


@dataclass(frozen=True, kw_only=True)
class ErrorGrid:
    """Values for which the joint space is measured.

    Attributes
    ----------
    angles_deg : tuple of float
        Tilts of the central ray, in degrees.
    axis : str
        Second axis, one of `AXES`.
    values : tuple of float
        Values of the second axis, in the unit of its protocol field.

    Raises
    ------
    InputError
        If the axis is unknown, or an axis has no values.
    """

    angles_deg: tuple[float, ...]
    axis: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the axis and its values."""
        require_choice("axis", self.axis, tuple(AXES))
        if not self.angles_deg or not self.values:
            raise InputError(f"angles and values must not be empty, got {len(self.angles_deg)} and {len(self.values)}")


def measure_jsw_errors(
    knees: Sequence[Knee], view: Protocol, grid: ErrorGrid, *, workers: int = 1
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Measure the projected medial joint space on a grid of beam angles and positions.

    The error is the difference from the joint space with the beam along the medial plateau, at the nominal position of
    the view.

    Parameters
    ----------
    knees : sequence of Knee
        Knees.
    view : Protocol
        Frontal view with nominal values.
    grid : ErrorGrid
        Beam angles and second axis.
    workers : int
        Number of processes.

    Returns
    -------
    errors : DataFrame
        One row per knee and point of the grid, with the columns `MAP_COLUMNS`.
    summary : DataFrame
        One row per knee, with the columns `SUMMARY_COLUMNS`: best beam angle, joint space at this angle, error at the
        nominal angle of the view, and root mean square error of the angles within 1 and 2 degrees of the best one.

    Raises
    ------
    InputError
        If the view is not frontal, a knee cannot be built, or a value is out of range.
    """
    if not view.posture.is_frontal or view.knee_distance_mm:
        raise InputError(f"view must be a frontal view of one knee, got {view.name}")
    view = replace(view, beam_along="horizontal")
    measured = map_in_parallel(
        _measure_knee, list(enumerate(knees)), shared={"view": view, "grid": grid}, workers=workers
    )
    errors = pd.DataFrame([row for rows, _ in measured for row in rows], columns=MAP_COLUMNS)
    return errors, pd.DataFrame([summary for _, summary in measured], columns=SUMMARY_COLUMNS)


def _measure_knee(
    item: tuple[int, Knee], *, view: Protocol, grid: ErrorGrid
) -> tuple[list[dict[str, Any]], Mapping[str, Any]]:
    """Measure one knee; return the rows of the grid and the summary."""
    number, knee = item
    posed = build(knee, view)
    aligned = posed.aim_beam(replace(view, beam_along="medial_plateau", beam_angle_deg=0.0))
    reference = _measure_medial_mm(posed, aligned)
    rows: list[dict[str, Any]] = []
    label = {"knee": number, "grade": knee.grade}
    for value in grid.values:
        moved = replace(view, **dict[str, Any]({AXES[grid.axis]: value}))
        of_value = posed if moved.posture == view.posture else build(knee, moved)
        for angle in grid.angles_deg:
            medial = _measure_medial_mm(of_value, replace(moved, beam_angle_deg=angle))
            row = {"axis": grid.axis, "beam_angle_deg": angle, "value": value}
            rows.append({**label, **row, "medial_mm": medial, "error_mm": medial - reference})
    best = aligned.beam_angle_deg
    summary = {
        **label,
        "best_angle_deg": best,
        "reference_mm": reference,
        "nominal_error_mm": _measure_medial_mm(posed, view) - reference,
    }
    for within in _WITHIN_DEG:
        around = [replace(view, beam_angle_deg=round(best + shift, 3)) for shift in np.linspace(-within, within, 5)]
        errors: Array = np.array([_measure_medial_mm(posed, one) - reference for one in around])
        summary[f"within_{within:g}_mm"] = float(np.sqrt(np.square(errors).mean()))
    return rows, summary


def _measure_medial_mm(built: BuiltKnee, protocol: Protocol) -> float:
    """Measure the projected minimum medial joint space, in mm in the joint plane."""
    medial = built.truth(protocol).jsw_medial_mm
    assert medial is not None
    return medial
