"""Lists of patient radiographs: the image files of a folder, or the rows of a CSV table."""

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..core.checks import InputError, require, require_choice
from ..data.looks import Processed
from .csv_rows import read_rows_of_csv
from .image_kind import SUFFIXES, files_of, is_image
from .images import reading

SIDES = ("right", "left")
GRADES = range(5)
COLUMNS = ("file", "grade", "subject", "side", "pixel_mm")
PIXEL_MM = (0.01, 5.0)
_WORDS = {
    "left": "left", "links": "left", "gauche": "left", "izquierda": "left", "izquierdo": "left", "sinistra": "left",
    "right": "right", "rechts": "right", "droite": "right", "droit": "right", "derecha": "right", "derecho": "right",
    "destra": "right",
}  # fmt: skip
_LETTERS = {"l": "left", "r": "right"}
# A word of its own, or one after a digit: left_12, 12-right-knee, 12left.
_WORD = re.compile(rf"(?:(?<=\d)|(?<![^\W_]))(?P<side>{'|'.join(_WORDS)})(?![^\W_])", re.IGNORECASE)
# At the end: L or R after a digit, or as a word of its own where a digit comes before it: 12L, 12_R, p12a-l.
_LETTER = re.compile(r"(?<=\d)(?P<side>[LR])$|(?<=[-_ .])(?P<lone>[LRlr])$")
_STROKES = "-_ ."


@dataclass(frozen=True, kw_only=True)
class Film:
    """One film of a folder.

    file      from the folder
    grade     Kellgren-Lawrence grade 0 to 4, None where it is not known
    subject   text; films of one subject go together
    side      right | left | None where it is not known
    pixel_mm  pitch at the film, None where it is not known
    sha256    of the file
    look      that linear pixels are shown with, None for "processed"; others are shown already
    coarse_mm pitch, of a knee of the standard size, that it is made smaller to before it is compared; None: as it is
    raises    InputError for a value out of its range
    """

    file: str
    grade: int | None
    subject: str
    side: str | None
    pixel_mm: float | None
    sha256: str
    look: Processed | None = None
    coarse_mm: float | None = None

    def __post_init__(self) -> None:
        for name in ("file", "subject", "sha256"):
            value = getattr(self, name)
            if not isinstance(value, str) or not (value or name == "sha256"):
                raise InputError(f"film {name} must be text, got {value!r}")
        if self.grade is not None:
            require_choice(f"film {self.file}: grade", self.grade, GRADES)
        if self.side is not None:
            require_choice(f"film {self.file}: side", self.side, SIDES)
        for name in ("pixel_mm", "coarse_mm"):
            if getattr(self, name) is not None:
                require(f"film {self.file}: {name}", getattr(self, name), *PIXEL_MM, "mm")


def list_films(folder: str | Path) -> tuple[Film, ...]:
    """List the films of a folder in the order of their names, or the rows of its table.

    Hidden files, resource forks (._x.png), locks (~$x.csv) and what is no image by its name or first bytes are left
    out. Without a table the name of a file gives subject and side; see `subject_and_side`.

    folder  holds folders 0 to 4, one per grade, and films without a grade beside them; or holds, or is, a CSV with the
            columns file, grade, subject, side, pixel_mm, of which all but the first may be left out or empty
    raises  InputError for a folder without films, a table with another column or value, a column or film twice, a film
            that is not there, or copies of one film that have two grades, subjects or sides
    """
    folder = Path(folder)
    is_table = folder.suffix.lower() == ".csv"
    tables = [folder] if is_table else [path for path in files_of(folder) if path.suffix.lower() == ".csv"]
    if len(tables) > 1:
        names = ", ".join(path.name for path in tables)
        raise InputError(f"folder {folder}: tables = {names}; allowed: one CSV, or folders 0 to 4")
    films = tuple(_of_table(tables[0])) if tables else tuple(_of_folders(folder))
    if not films:
        raise InputError(f"folder {folder}: films = none; allowed: folders 0 to 4 of {', '.join(SUFFIXES)}, or a CSV")
    _require_one_of_each(films, folder)
    return films


def subject_and_side(stem: str) -> tuple[str, str | None]:
    """Read subject and side from the name of a film without its suffix.

    A side is the word left or right (links, rechts, gauche, droite, ...) on its own or after a digit, or L or R at the
    end: after a digit, or on its own where a digit comes before it. The rest of the name is the subject, so that
    9003175L and 9003175_R, or P1_left and P1_right, are of one person. Without a side, or with both, the whole name is
    the subject.

    Examples
    --------
    >>> subject_and_side("9003175_R"), subject_and_side("P1_left_knee"), subject_and_side("P1")
    (('9003175', 'right'), ('P1_knee', 'left'), ('P1', None))
    """
    words = list(_WORD.finditer(stem))
    if len({_WORDS[word["side"].lower()] for word in words}) == 1:
        return _without(stem, words[0]), _WORDS[words[0]["side"].lower()]
    match = None if words else _LETTER.search(stem)
    if match is None or (match["lone"] and not re.search(r"\d", stem)):
        return stem, None
    return _without(stem, match), _LETTERS[(match["side"] or match["lone"]).lower()]


def require_film(path: Path, what: str = "") -> None:
    """Refuse a path that is no image by its name nor by its first bytes.

    what    what a refusal says of the file; "": its path

    raises  InputError
    """
    if path.suffix.lower() not in SUFFIXES and path.is_file():
        with reading(path, "a film", "damaged"):
            if is_image(path):
                return
    require_choice(f"{what or f'file {path}'}: suffix", path.suffix.lower(), SUFFIXES)


def _without(stem: str, match: re.Match[str]) -> str:
    """The name without its side, with one stroke where two words are left; the whole where nothing is left."""
    before, after = stem[: match.start()].rstrip(_STROKES), stem[match.end() :].lstrip(_STROKES)
    return "_".join(part for part in (before, after) if part) or stem


def _require_one_of_each(films: tuple[Film, ...], folder: Path) -> None:
    """Refuse copies of a file that do not say the same of it: a film would have two truths, or two people in one."""
    known: dict[str, Film] = {}
    for film in films:
        other = known.setdefault(film.sha256, film)
        for name in ("grade", "subject", "side"):
            one, two = getattr(other, name), getattr(film, name)
            if one != two and None not in (one, two):
                raise InputError(
                    f"folder {folder}: {other.file} and {film.file} are the same film, with {name} = {one} and {two}; "
                    f"allowed: one {name}"
                )


def _of_folders(folder: Path) -> Iterator[Film]:
    graded: list[tuple[int | None, Path]] = [(grade, folder / str(grade)) for grade in GRADES]
    for grade, place in [*graded, (None, folder)]:
        for path in files_of(place):
            if is_image(path):
                subject, side = subject_and_side(_stem(path))
                file = path.relative_to(folder).as_posix()
                yield Film(file=file, grade=grade, subject=subject, side=side, pixel_mm=None, sha256=_sha256(path))


def _stem(path: Path) -> str:
    """The name without its suffix; the whole name of a DICOM without one, such as 1.2.840.1."""
    return path.stem if path.suffix.lower() in SUFFIXES else path.name


def _of_table(path: Path) -> Iterator[Film]:
    names, rows = read_rows_of_csv(path)
    if "file" not in names:
        raise InputError(f"file {path}: columns = {', '.join(names) or 'none'}; required: file")
    for name in names:
        require_choice(f"file {path}: column", name, COLUMNS)
    seen: set[str] = set()
    for line, row in enumerate(rows, start=2):
        film = _of_row(path.parent, row, f"file {path}, line {line}")
        place = Path(film.file).as_posix()
        if place in seen:
            raise InputError(f"file {path}, line {line}: file = {film.file!r}, again; allowed: each once")
        seen.add(place)
        yield film


def _of_row(folder: Path, row: dict[str, str], where: str) -> Film:
    file, grade, subject, side, pixel = (row.get(name, "").strip() for name in COLUMNS)
    if not file:
        raise InputError(f"{where}: file = ''; allowed: the path of a film from the table's folder")
    require_film(folder / file, where)
    if side:
        require_choice(f"{where}: side", side, SIDES)
    named = _named(Path(file))
    return Film(
        file=file,
        grade=_grade(f"{where}: grade", grade) if grade else None,
        subject=_whole(subject) or named[0],
        side=side or named[1],
        pixel_mm=_pixel_mm(f"{where}: pixel_mm", pixel) if pixel else None,
        sha256=_sha256(folder / file),
    )


def _named(file: Path) -> tuple[str, str | None]:
    """Subject and side by a film's name, or by its folder's where the name is a side alone: P1/left.png."""
    stem = _stem(file)
    subject, side = subject_and_side(stem)
    alone = side is not None and subject == stem
    return (file.parent.as_posix() if alone and file.parent.name else subject), side


def _whole(text: str) -> str:
    """A number as it was before a data frame with gaps made a float of it: 2.0 is 2; any other text as it is."""
    return re.sub(r"(?<=\d)\.0$", "", text) if re.fullmatch(r"\d+\.0", text) else text


def _grade(name: str, text: str) -> int:
    require_choice(name, _whole(text), [str(value) for value in GRADES])
    return int(_whole(text))


def _pixel_mm(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{name} = {text!r}; allowed: a number of mm, or nothing") from None
    require(name, value, *PIXEL_MM, "mm")
    return value


def _sha256(path: Path) -> str:
    with reading(path, "a film", "damaged"), open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
