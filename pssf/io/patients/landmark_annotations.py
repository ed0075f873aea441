"""Read landmarks that a person has marked on radiographs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.checks import Array, InputError
from ..csv_rows import read_csv_rows


@dataclass(frozen=True, kw_only=True, eq=False)
class LandmarkAnnotation:
    """Landmarks of one knee.

    Attributes
    ----------
    file : str
        Name of the radiograph.
    side : {"right", "left"}
        Side of the knee.
    grade : int or None
        KL grade; None if the table has none.
    landmarks_mm : (16, 2) array
        x and y of each landmark, in mm; y points downwards, and x from lateral to medial.
    """

    file: str
    side: str
    grade: int | None
    landmarks_mm: Array


def read_landmark_annotations(path: Path, names: tuple[str, ...]) -> list[LandmarkAnnotation]:
    """Read a table of annotated landmarks.

    Parameters
    ----------
    path : Path
        CSV file with the columns file, side (R or L, or right or left), NAME_x_mm and NAME_y_mm for each landmark, and
        optionally kl. Landmarks of left knees are mirrored, so that x points from lateral to medial.
    names : tuple of str
        Names of the landmarks.

    Returns
    -------
    list of LandmarkAnnotation
        Annotations in the order of the rows.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, or a cell is not a number or not a side.
    """
    columns, rows = read_csv_rows(path)
    wanted = ("file", "side", *(f"{name}_{axis}_mm" for name in names for axis in "xy"))
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise InputError(f"file {path} must have the columns of annotated landmarks, got no column {missing[0]}")
    return [_parse_row(path, number, row, names) for number, row in enumerate(rows, start=2)]


def _parse_row(path: Path, number: int, row: dict[str, str], names: tuple[str, ...]) -> LandmarkAnnotation:
    """Parse one row."""
    sides = {"r": "right", "l": "left"}
    side = sides.get(row.get("side", "").strip().lower()[:1])
    if side is None:
        raise InputError(f"file {path}, line {number}: side must be right or left, got {row.get('side', '')!r}")
    try:
        places = np.array([[float(row[f"{name}_{axis}_mm"]) for axis in "xy"] for name in names])
        grade = int(row["kl"]) if row.get("kl") else None
    except (KeyError, ValueError) as error:
        raise InputError(f"file {path}, line {number}: landmarks and kl must be numbers, got {error}") from None
    if not np.isfinite(places).all():
        raise InputError(f"file {path}, line {number}: landmarks must be finite, got {places.min():g}")
    return LandmarkAnnotation(file=row["file"], side=side, grade=grade, landmarks_mm=places)
