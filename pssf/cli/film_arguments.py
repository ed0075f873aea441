"""Radiographs that the user names on the command line."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..io.patients.patient_radiographs import Film


def collect_films(path: Path, side: str, pixel_mm: float) -> "list[Film]":
    """List the radiographs of a path.

    Parameters
    ----------
    path : Path
        Radiograph, folder of radiographs, or CSV file that lists radiographs.
    side : str
        Side of radiographs whose file names and tables do not contain it; empty: unknown.
    pixel_mm : float
        Pixel size of radiographs whose tables do not contain it, in mm; 0: unknown.

    Returns
    -------
    list of Film
        Radiographs.

    Raises
    ------
    InputError
        No radiograph exists at the path, or `side` or `pixel_mm` is not allowed.
    """
    from dataclasses import replace

    from ..core.checks import require_choice, require_in_range
    from ..io.cohort_records import hash_file
    from ..io.patients.patient_list import (
        PIXEL_MM_RANGE,
        SIDES,
        Film,
        list_films,
        parse_subject_and_side,
        require_film,
    )

    if side:
        require_choice("side", side, SIDES)
    if pixel_mm:
        require_in_range("pixel-mm", pixel_mm, *PIXEL_MM_RANGE, "mm")
    if path.is_dir() or path.suffix.lower() == ".csv":
        folder = path if path.is_dir() else path.parent
        films = [replace(film, file=(folder / film.file).as_posix()) for film in list_films(path)]
    else:
        require_film(path)
        file, (subject, own) = path.as_posix(), parse_subject_and_side(path.stem)
        films = [Film(file=file, grade=None, subject=subject, side=own, pixel_mm=None, sha256=hash_file(path))]
    return [replace(f, side=f.side or side or None, pixel_mm=f.pixel_mm or pixel_mm or None) for f in films]


def make_unique_stem(file: str, used_names: set[str]) -> str:
    """Return the stem of a file, with a number appended if another file has the same stem.

    Parameters
    ----------
    file : str
        Path of the file.
    used_names : set of str
        Names of earlier files; the new name is added.

    Returns
    -------
    str
        Name that no earlier file has.
    """
    stem, count = Path(file).stem, 1
    name = stem
    while name in used_names:
        count += 1
        name = f"{stem}_{count}"
    used_names.add(name)
    return name
