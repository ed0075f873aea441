"""Table rows with the readings of a radiograph."""

from collections.abc import Sequence
from typing import Any

from .knee_reading import KneeReading

Row = dict[str, Any]
# Status of a knee that was read, and of an image on which no knee was found.
READ = "read"
NO_KNEE = "no knee"


def make_rows(file: str, knees: Sequence[KneeReading]) -> list[Row]:
    """Make one row per knee, or one row with the status "no knee".

    Parameters
    ----------
    file : str
        File of the radiograph.
    knees : sequence of KneeReading
        Result of `read`.

    Returns
    -------
    list of dict
        Rows with file, status, side, joint measures, landmarks in pixels and confidences. Lengths in mm are None if the
        pixel size is unknown.
    """
    return [_make_row(file, knee) for knee in knees] or [{"file": file, "status": NO_KNEE}]


def _make_row(file: str, knee: KneeReading) -> Row:
    """Make the row of one knee."""
    measures = knee.measures
    row: Row = {
        "file": file,
        "status": f"refused: {knee.refusal}" if knee.refusal else READ,
        "side": knee.side,
        "score": round(knee.score, 4),
        "side_confidence": round(knee.side_confidence, 4),
        "shape_residual": round(knee.shape_residual, 4),
        "angle_deg": round(knee.angle_deg, 3),
        "pixel_mm": knee.pixel_mm,
        "plateau_width_px": round(measures.plateau_width_px, 3),
        "plateau_width_mm": _round(knee.plateau_width_mm),
        "medial_jsw_mm": _round(knee.medial_jsw_mm),
        "lateral_jsw_mm": _round(knee.lateral_jsw_mm),
        "medial_jsw_share": round(measures.medial_jsw_share, 5),
        "lateral_jsw_share": round(measures.lateral_jsw_share, 5),
        "joint_line_convergence_deg": round(measures.joint_line_convergence_deg, 3),
    }
    row |= {f"jsw_at_{at:.3f}_share": round(share, 5) for at, share in measures.jsw_at_share.items()}
    for name, (row_px, col_px) in knee.landmarks_px.items():
        row |= {f"{name}_row_px": round(row_px, 3), f"{name}_col_px": round(col_px, 3)}
    return row | {f"{name}_confidence": round(value, 3) for name, value in knee.confidence.items()}


def _round(length_mm: float | None) -> float | None:
    """Round a length, in mm."""
    return None if length_mm is None else round(length_mm, 3)
