"""List the patient radiographs of a folder or of a CSV table."""

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...core.checks import InputError, require_choice, require_in_range
from ...data.imaging.display_table import FlatPanelProcessing
from ..csv_rows import read_csv_rows
from ..image_kind import SUFFIXES, is_image, list_files
from ..radiograph_files import convert_read_errors

SIDES = ("right", "left")
GRADES = range(5)
COLUMNS = ("file", "grade", "subject", "side", "pixel_mm")
# Smallest and largest accepted pixel size, in mm.
PIXEL_MM_RANGE = (0.01, 5.0)
_SIDE_WORDS = {
    "left": "left", "links": "left", "gauche": "left", "izquierda": "left", "izquierdo": "left", "sinistra": "left",
    "right": "right", "rechts": "right", "droite": "right", "droit": "right", "derecha": "right", "derecho": "right",
    "destra": "right",
}  # fmt: skip
_SIDE_LETTERS = {"l": "left", "r": "right"}
# Left or right as a separate word or after a digit, for example left_12, 12-right-knee, 12left.
_SIDE_WORD_PATTERN = re.compile(rf"(?:(?<=\d)|(?<![^\W_]))(?P<side>{'|'.join(_SIDE_WORDS)})(?![^\W_])", re.IGNORECASE)
# L or R at the end of a file name, after a digit or as a separate word, for example 12L, 12_R, p12a-l.
_SIDE_LETTER_PATTERN = re.compile(r"(?<=\d)(?P<side>[LR])$|(?<=[-_ .])(?P<lone>[LRlr])$")
_SEPARATORS = "-_ ."


@dataclass(frozen=True, kw_only=True)
class Film:
    """Entry of a list of patient radiographs.

    Parameters
    ----------
    file : str
        Path of the image file, relative to the listed folder.
    grade : int or None
        Kellgren-Lawrence grade, 0 to 4; None if unknown.
    subject : str
        Subject identifier. All radiographs of one subject go into the same subset when data are split.
    side : {"right", "left"} or None
        Knee side; None if unknown.
    pixel_mm : float or None
        Pixel size at the detector, 0.01 to 5 mm; None if unknown.
    sha256 : str
        SHA-256 of the file, in hexadecimal digits.
    processing : FlatPanelProcessing or None
        Display processing of linear pixels; None uses the display preset "processed". Images that are already processed
        for display are not changed.
    resampled_pixel_mm : float or None
        Pixel size of the image after downsampling for a comparison, 0.01 to 5 mm for a knee of standard size. None
        keeps the original pixel size.

    Raises
    ------
    InputError
        A value is out of range.
    """

    file: str
    grade: int | None
    subject: str
    side: str | None
    pixel_mm: float | None
    sha256: str
    processing: FlatPanelProcessing | None = None
    resampled_pixel_mm: float | None = None

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("file", "subject", "sha256"):
            value = getattr(self, name)
            if not isinstance(value, str) or not (value or name == "sha256"):
                raise InputError(f"patient radiograph: {name} must be text, got {value!r}")
        if self.grade is not None:
            require_choice(f"radiograph {self.file}: grade", self.grade, GRADES)
        if self.side is not None:
            require_choice(f"radiograph {self.file}: side", self.side, SIDES)
        for name in ("pixel_mm", "resampled_pixel_mm"):
            if getattr(self, name) is not None:
                require_in_range(f"radiograph {self.file}: {name}", getattr(self, name), *PIXEL_MM_RANGE, "mm")


def list_films(folder: str | Path) -> tuple[Film, ...]:
    """List the patient radiographs of a folder in alphabetical order, or of a CSV table in row order.

    Hidden files, resource forks (._x.png), lock files (~$x.csv) and files that are not images are ignored.

    Parameters
    ----------
    folder : str or Path
        One of three sources: a folder with subfolders 0 to 4, one per grade, which may also contain ungraded
        radiographs; a folder with one CSV table; or the path of a CSV table. The table columns are file, grade,
        subject, side and pixel_mm; only file is required.

    Returns
    -------
    tuple of Film
        Listed radiographs. Without a table, subject and side are parsed from the file name; see
        `parse_subject_and_side`.

    Raises
    ------
    InputError
        No radiograph is found, a listed file does not exist, a table column or value is not allowed, a column or file
        is repeated, or copies of one file differ in grade, subject or side.
    """
    folder = Path(folder)
    is_table = folder.suffix.lower() == ".csv"
    tables = [folder] if is_table else [path for path in list_files(folder) if path.suffix.lower() == ".csv"]
    if len(tables) > 1:
        names = ", ".join(path.name for path in tables)
        raise InputError(f"folder {folder} must contain one CSV file or subfolders 0 to 4, got CSV files {names}")
    films = tuple(_list_table_films(tables[0])) if tables else tuple(_list_folder_films(folder))
    if not films:
        raise InputError(
            f"folder {folder} contains no radiographs: the folder must contain subfolders named 0 to 4 (the grades) "
            f"with {', '.join(SUFFIXES)} files, or a CSV file that lists the radiographs"
        )
    _require_consistent_copies(films, folder)
    return films


def parse_subject_and_side(stem: str) -> tuple[str, str | None]:
    """Parse the subject and the knee side from the file name of a radiograph.

    The side is the word left or right (or links, rechts, gauche, droite and others), as a separate word or after a
    digit. A final L or R also denotes the side if it follows a digit or is a separate word in a name with a digit. The
    remaining text is the subject: 9003175L and 9003175_R belong to one subject, and so do P1_left and P1_right.

    Parameters
    ----------
    stem : str
        File name without suffix.

    Returns
    -------
    subject : str
        Subject identifier; the entire `stem` if it contains no side or both sides.
    side : {"right", "left"} or None
        Knee side; None if `stem` contains no side or both sides.

    Examples
    --------
    >>> parse_subject_and_side("9003175_R"), parse_subject_and_side("P1_left_knee"), parse_subject_and_side("P1")
    (('9003175', 'right'), ('P1_knee', 'left'), ('P1', None))
    """
    words = list(_SIDE_WORD_PATTERN.finditer(stem))
    if len({_SIDE_WORDS[word["side"].lower()] for word in words}) == 1:
        return _remove_side(stem, words[0]), _SIDE_WORDS[words[0]["side"].lower()]
    match = None if words else _SIDE_LETTER_PATTERN.search(stem)
    if match is None or (match["lone"] and not re.search(r"\d", stem)):
        return stem, None
    return _remove_side(stem, match), _SIDE_LETTERS[(match["side"] or match["lone"]).lower()]


def require_film(path: Path, label: str = "") -> None:
    """Require that a file has the suffix or the first bytes of an image file.

    Parameters
    ----------
    path : Path
        File to check.
    label : str
        File description for error messages; if empty, messages show the path.

    Raises
    ------
    InputError
        The file is not an image, or cannot be read.
    """
    if path.suffix.lower() not in SUFFIXES and path.is_file():
        with convert_read_errors(path, "a radiograph", "damaged"):
            if is_image(path):
                return
    require_choice(f"{label or f'file {path}'}: suffix", path.suffix.lower(), SUFFIXES)


def _remove_side(stem: str, match: re.Match[str]) -> str:
    """Remove the side from a file name and join the remaining parts with "_"; keep the name if no part remains."""
    before, after = stem[: match.start()].rstrip(_SEPARATORS), stem[match.end() :].lstrip(_SEPARATORS)
    return "_".join(part for part in (before, after) if part) or stem


def _require_consistent_copies(films: tuple[Film, ...], folder: Path) -> None:
    """Require that copies of one file have the same grade, subject and side.

    Inconsistent copies would give one radiograph two labels, or count one subject twice.
    """
    known: dict[str, Film] = {}
    for film in films:
        other = known.setdefault(film.sha256, film)
        for name in ("grade", "subject", "side"):
            one, two = getattr(other, name), getattr(film, name)
            if one != two and None not in (one, two):
                raise InputError(
                    f"folder {folder}: {other.file} and {film.file} are copies, so their {name} must be equal, got "
                    f"{one} and {two}"
                )


def _list_folder_films(folder: Path) -> Iterator[Film]:
    """Yield the radiographs in the subfolders 0 to 4, then the radiographs in the folder itself."""
    graded: list[tuple[int | None, Path]] = [(grade, folder / str(grade)) for grade in GRADES]
    for grade, place in [*graded, (None, folder)]:
        for path in list_files(place):
            if is_image(path):
                subject, side = parse_subject_and_side(_stem(path))
                file = path.relative_to(folder).as_posix()
                yield Film(file=file, grade=grade, subject=subject, side=side, pixel_mm=None, sha256=_hash_film(path))


def _stem(path: Path) -> str:
    """Return the file name without its suffix. A DICOM name without a suffix, such as 1.2.840.1, is not shortened."""
    return path.stem if path.suffix.lower() in SUFFIXES else path.name


def _list_table_films(path: Path) -> Iterator[Film]:
    """Yield the radiographs of a CSV table."""
    names, rows = read_csv_rows(path)
    if "file" not in names:
        raise InputError(f"file {path} must have a column named file, got {', '.join(names) or 'no columns'}")
    for name in names:
        require_choice(f"file {path}: column", name, COLUMNS)
    seen: set[str] = set()
    for line, row in enumerate(rows, start=2):
        film = _make_film(path.parent, row, f"file {path}, line {line}")
        place = Path(film.file).as_posix()
        if place in seen:
            raise InputError(f"file {path}, line {line}: file must be listed once, got {film.file!r} again")
        seen.add(place)
        yield film


def _make_film(folder: Path, row: dict[str, str], where: str) -> Film:
    """Make the `Film` for one row of a CSV table; `where` identifies the row in error messages."""
    file, grade, subject, side, pixel = (row.get(name, "").strip() for name in COLUMNS)
    if not file:
        raise InputError(f"{where}: file must be the path of a radiograph, relative to the table, got an empty cell")
    require_film(folder / file, where)
    if side:
        require_choice(f"{where}: side", side, SIDES)
    named = _parse_file_name(Path(file))
    return Film(
        file=file,
        grade=_parse_grade(f"{where}: grade", grade) if grade else None,
        subject=_remove_zero_decimal(subject) or named[0],
        side=side or named[1],
        pixel_mm=_parse_pixel_mm(f"{where}: pixel_mm", pixel) if pixel else None,
        sha256=_hash_film(folder / file),
    )


def _parse_file_name(file: Path) -> tuple[str, str | None]:
    """Parse subject and side from a file name; for a name such as P1/left.png the folder is the subject."""
    stem = _stem(file)
    subject, side = parse_subject_and_side(stem)
    alone = side is not None and subject == stem
    return (file.parent.as_posix() if alone and file.parent.name else subject), side


def _remove_zero_decimal(text: str) -> str:
    """Remove ".0" from integers that a data frame with missing values stored as floats; do not change other text."""
    return re.sub(r"(?<=\d)\.0$", "", text) if re.fullmatch(r"\d+\.0", text) else text


def _parse_grade(name: str, text: str) -> int:
    """Parse the grade in a table cell."""
    require_choice(name, _remove_zero_decimal(text), [str(value) for value in GRADES])
    return int(_remove_zero_decimal(text))


def _parse_pixel_mm(name: str, text: str) -> float:
    """Parse the pixel size in a table cell, in mm."""
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{name} must be a number in mm, or empty, got {text!r}") from None
    require_in_range(name, value, *PIXEL_MM_RANGE, "mm")
    return value


def _hash_film(path: Path) -> str:
    """Compute the SHA-256 of an image file."""
    with convert_read_errors(path, "a radiograph", "damaged"), open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
