"""Films of any source: what a folder holds, and the pixels of one film as they are displayed."""

import csv
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from ..core.checks import Array, InputError, require, require_choice, require_whole
from ..data.looks import Processed
from ..detector import present
from .film_tiff import read_packed
from .images import load, load_parameters, reading

SIDES = ("right", "left")
GRADES = range(5)
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".dcm")
COLUMNS = ("file", "grade", "subject", "side", "pixel_mm")
# Least side of a film, pixels: a joint of 100 mm is resolved to some 1.5 mm.
LEAST_PX = 64
_PIXEL_MM = (0.01, 5.0)
# A digit, then L or R at the end, with or without a stroke between: 9003175L, 9003175_R.
_SIDED = re.compile(r"(?P<subject>.*\d)[-_ ]?(?P<side>[LR])")
# Mode of Pillow -> grey values.
_GREY = {"L": 2**8, "I;16": 2**16, "I;16L": 2**16, "I;16B": 2**16, "I;16N": 2**16}
_COLOUR = ("P", "PA", "LA", "RGB", "RGBA")
# Channels of a grey picture differ by what a JPEG's colour transform rounds.
_GREY_SPREAD = 8 / 255
_WHITE_IS_ZERO, _PHOTOMETRIC = 0, 262


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
    """

    file: str
    grade: int | None
    subject: str
    side: str | None
    pixel_mm: float | None
    sha256: str
    look: Processed | None = None
    coarse_mm: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmImage:
    """A film as it is displayed.

    pixels    (rows, cols) 0 to 1 over the range of its bits; bone bright, unless it is inverted and does not say so
    pixel_mm  pitch at the film or detector, where the file says so: DICOM, and what this package wrote. Resolutions in
              other files are for print, and not believed
    side      right | left, where the file says so
    """

    pixels: Array
    pixel_mm: float | None = None
    side: str | None = None


def list_films(folder: str | Path) -> tuple[Film, ...]:
    """Films of a folder, in the order of their names, or of the rows of its table.

    folder  holds folders 0 to 4, one a grade, and films without a grade beside them; or holds, or is, a CSV with the
            columns file, grade, subject, side, pixel_mm, of which all but the first may be left out or empty. Without a
            table a name that ends in a digit and L or R, such as 9003175L.png or 9003175_R.png, gives subject and side;
            of any other name all is the subject, and the side is not known.
    raises  InputError for a folder without films, a table with another column or value, a film twice or not there, or
            copies of one film that have two grades, subjects or sides
    """
    folder = Path(folder)
    tables = [folder] if folder.suffix.lower() == ".csv" else sorted(folder.glob("*.csv"))
    if len(tables) > 1:
        names = ", ".join(path.name for path in tables)
        raise InputError(f"folder {folder}: tables = {names}; allowed: one CSV, or folders 0 to 4")
    films = tuple(_of_table(tables[0])) if tables else tuple(_of_folders(folder))
    if not films:
        raise InputError(f"folder {folder}: films = none; allowed: folders 0 to 4 of {', '.join(SUFFIXES)}, or a CSV")
    _require_one_of_each(films, folder)
    return films


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
        for path in sorted(place.glob("*")):
            if path.suffix.lower() in SUFFIXES and path.is_file():
                subject, side = subject_and_side(path.stem)
                file = path.relative_to(folder).as_posix()
                yield Film(file=file, grade=grade, subject=subject, side=side, pixel_mm=None, sha256=_sha256(path))


def subject_and_side(stem: str) -> tuple[str, str | None]:
    """What the name of a film says, by the rule of `list_films`."""
    match = _SIDED.fullmatch(stem)
    if match is None:
        return stem, None
    return match["subject"], {"R": "right", "L": "left"}[match["side"]]


def _of_table(path: Path) -> Iterator[Film]:
    with reading(path, "a CSV of films", "damaged"), open(path, newline="", encoding="utf-8-sig") as handle:
        table = csv.DictReader(handle, restkey="?", restval="")
        names, rows = list(table.fieldnames or []), list(table)
    names += ["?"] * any("?" in row for row in rows)
    if "file" not in names:
        raise InputError(f"file {path}: columns = {', '.join(names) or 'none'}; required: file")
    for name in names:
        require_choice(f"file {path}: column", name, COLUMNS)
    seen: set[str] = set()
    for line, row in enumerate(rows, start=2):
        film = _of_row(path.parent, row, f"file {path}, line {line}")
        if film.file in seen:
            raise InputError(f"file {path}, line {line}: file = {film.file!r}, again; allowed: each once")
        seen.add(film.file)
        yield film


def _of_row(folder: Path, row: dict[str, str], where: str) -> Film:
    file = row["file"].strip()
    grade, subject, side, pixel = (row.get(name, "").strip() for name in COLUMNS[1:])
    require_choice(f"{where}: suffix", Path(file).suffix.lower(), SUFFIXES)
    if grade:
        require_choice(f"{where}: grade", grade, [str(value) for value in GRADES])
    if side:
        require_choice(f"{where}: side", side, SIDES)
    named = subject_and_side(Path(file).stem)
    return Film(
        file=file,
        grade=int(grade) if grade else None,
        subject=subject or named[0],
        side=side or named[1],
        pixel_mm=_pixel_mm(f"{where}: pixel_mm", pixel) if pixel else None,
        sha256=_sha256(folder / file),
    )


def _pixel_mm(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{name} = {text!r}; allowed: a number of mm, or nothing") from None
    require(name, value, *_PIXEL_MM, "mm")
    return value


def _sha256(path: Path) -> str:
    with reading(path, "a film", "damaged"), open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def read_film(path: str | Path, look: Processed | None = None) -> FilmImage:
    """A film as it is displayed; linear pixels, and others' logarithms of them, are rendered for eyes first.

    look    that they are rendered with; None: "processed"
    path    PNG, JPEG, TIFF or DICOM of 8 to 16 bit; of colour only what is grey in truth
    raises  InputError naming a file that is missing, empty, damaged, of another kind, of several frames, coloured, of
            one grey value or too small; one whose pixels are not square; a DICOM For Processing that does not say how
            its pixels hang on the beam
    """
    path = Path(path)
    require_choice(f"file {path}: suffix", path.suffix.lower(), SUFFIXES)
    with reading(path, "a readable film of 8 to 16 bit", "damaged"):
        if path.stat().st_size == 0:
            raise InputError(f"file {path}: size = 0 bytes; allowed: a film")
        if path.suffix.lower() == ".dcm":
            from . import film_dicom  # pydicom is not imported before a DICOM is wanted

            ours = film_dicom.is_linear_by_pssf(path)
            film = _rendered(path, look) if ours else FilmImage(**film_dicom.read(path, _PIXEL_MM, look))
        else:
            packed = read_packed(path) if path.suffix.lower() in (".tif", ".tiff") else None
            film = _picture(path, look) if packed is None else FilmImage(pixels=packed)
    for name, length in zip(("rows", "columns"), film.pixels.shape, strict=True):
        require_whole(f"file {path}: {name}", length, LEAST_PX, 2**16, "pixels")
    least, most = float(film.pixels.min()), float(film.pixels.max())
    if not most > least:
        raise InputError(f"file {path}: pixels = {least:g} throughout; allowed: more than one grey value")
    return film


def _rendered(path: Path, look: Processed | None) -> FilmImage:
    """Linear pixels of this package, for eyes."""
    radiograph = load(path)
    shown = present(radiograph, bits=16, look=look or "processed")
    side = None if radiograph.knee is None else radiograph.knee.side
    return FilmImage(pixels=shown / 65535.0, pixel_mm=radiograph.protocol.pixel_mm, side=side)


def _picture(path: Path, look: Processed | None) -> FilmImage:
    """A PNG, JPEG or TIFF."""
    with _opened(path) as image:
        frames = getattr(image, "n_frames", 1)
        if frames > 1:
            raise InputError(f"file {path}: frames = {frames}; allowed: 1")
        if "pssf" in str(getattr(image, "tag_v2", {}).get(305, "")):
            return _rendered(path, look)
        said: dict[str, Any] = _said_by_pssf(path) if "Description" in image.info else {}
        upright = ImageOps.exif_transpose(image)
        pixels = _grey(np.asarray(_flat(upright, path)), upright.mode, path)
        # Pillow turns white-is-zero round at 8 bit, and leaves it at 16.
        if image.mode != "L" and getattr(image, "tag_v2", {}).get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
            pixels = 1.0 - pixels
    return FilmImage(pixels=pixels, **said)


def _opened(path: Path) -> Image.Image:
    """The picture with its pixels."""
    image = None
    try:
        image = Image.open(path)
        image.load()
        return image
    except OSError as error:  # Pillow's own, as if the disk were at fault, for what is no picture or not whole
        if image is not None:
            image.close()
        if error.errno is not None:
            raise
        raise InputError(f"file {path}: damaged, or no picture; allowed: a readable film of 8 to 16 bit") from None


def _said_by_pssf(path: Path) -> dict[str, Any]:
    """Pitch and side, if the picture is one of this package's."""
    try:
        made = load_parameters(path)
    except InputError:
        return {}
    return {"pixel_mm": made["protocol"].pixel_mm, "side": None if made["knee"] is None else made["knee"].side}


def _flat(image: Image.Image, path: Path) -> Image.Image:
    """The picture without a palette."""
    require_choice(f"file {path}: kind of pixel", image.mode, (*_GREY, *_COLOUR))
    return image.convert("RGBA") if image.mode in _COLOUR else image


def _grey(values: NDArray[Any], mode: str, path: Path) -> Array:
    """(rows, cols) 0 to 1 of grey values, or of the channels of a colour picture that are alike."""
    if mode in _GREY:
        return values.astype(np.float64) / (_GREY[mode] - 1)
    shown = values.astype(np.float64) / 255.0
    if shown[..., 3].min() < 1.0:
        raise InputError(f"file {path}: opacity = {shown[..., 3].min():.2f} somewhere; allowed: 1 throughout")
    spread = float(np.ptp(shown[..., :3], axis=2).max())
    if spread > _GREY_SPREAD:
        raise InputError(f"file {path}: channels differ by = {spread:.2f}; allowed: up to {_GREY_SPREAD:.2f}")
    return np.asarray(shown[..., :3].mean(axis=2))
