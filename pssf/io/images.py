"""Radiographs on disk: 16-bit TIFF and DICOM that carry all they were made from, PNG and a second DICOM for eyes."""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tifffile
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from ..core.checks import InputError, require_choice, require_path
from ..core.keywords import keywords
from ..data.looks import Film, Processed, looks
from ..data.userfiles import read_text, require_file
from ..detector import look_of, named_look, present
from ..model.radiograph import Radiograph
from .atomic import write_bytes, writing
from .description import as_json, parameters, require_as_written, require_parameters
from .image_kind import is_dicom

# What a file may be for, its first use being the default; see `save`.
INTENTS = {
    ".tif": ("processing",),
    ".tiff": ("processing",),
    ".dcm": ("processing", "presentation"),
    ".png": ("presentation",),
}
SUFFIXES = tuple(INTENTS)
BORDERS = ("none", "marked")
# Tag of a TIFF that holds what it was made from.
_DESCRIPTION = 270
_MARKED = "for a presentation of one knee, of a known side; else none"
# What `save_kinds` writes.
KINDS = ("tif", "png", "json", "dcm")


@keywords()
def save(
    radiograph: Radiograph,
    path: str | Path,
    *,
    intent: str | None = None,
    border: str = "none",
    look: str | Processed | Film = "processed",
) -> Path:
    """Write a radiograph, by suffix: .tif (16 bit), .dcm (Digital X-Ray, 16 or 12 bit) or .png (8 bit).

    intent  "processing": the linear pixels as they are, which `load` reads back; "presentation": a rendering for eyes,
            bone bright. None is the first that the suffix can hold: presentation for .png, else processing. These are
            DICOM's own words, For Processing and For Presentation, and two objects there; only a .dcm has the choice.
    border  "none"; "marked" draws the edge of the collimator and the side marker into a presentation of a knee
    look    of a presentation, as `present` has it; the file names it and its parameters
    Either carries all parameters; the same radiograph gives the same bytes, and UIDs made from its content.
    raises  InputError for another suffix, an intent that it cannot hold, an unknown look, a marker where there is no
            room or no side, a disk that is full or cannot be written
    """
    path = require_path(path)
    require_radiograph(radiograph)
    suffix = suffix_of(path, SUFFIXES)
    intent = INTENTS[suffix][0] if intent is None else intent
    require_choice(f"file {path}: intent", intent, INTENTS[suffix])
    side, shown_as = _side(radiograph, intent, border, path), look_of(look, looks())
    with writing(path) as temporary:
        if suffix == ".png":
            note = PngImagePlugin.PngInfo()
            note.add_text("Description", as_json(radiograph))
            note.add_text("Look", named_look(shown_as))
            Image.fromarray(present(radiograph, side=side, look=shown_as or "linear")).save(
                temporary, format="PNG", pnginfo=note
            )
        elif suffix == ".dcm":
            from . import dicom  # pydicom is not imported before a DICOM is wanted

            dicom.write(radiograph, as_json(radiograph), temporary, intent, side, shown_as)
        else:
            per_cm = float(10.0 / radiograph.protocol.pixel_mm)
            tifffile.imwrite(
                temporary,
                radiograph.pixels,
                photometric="minisblack",
                resolution=(per_cm, per_cm),
                resolutionunit="CENTIMETER",
                software=f"pssf {version('pssf')}",
                # tifffile's own readers take JSON with "shape": for theirs; with a blank it is the same JSON.
                description=as_json(radiograph).replace('"shape":', '"shape" :'),
                metadata=None,
            )
    return path


def _side(radiograph: Radiograph, intent: str, border: str, path: Path) -> str | None:
    """Whose marker a presentation bears, if any."""
    require_choice(f"file {path}: border", border, BORDERS)
    if border == "none":
        return None
    if intent != "presentation" or radiograph.knee is None:
        raise InputError(f"file {path}: border = {border!r}; allowed: {_MARKED}")
    return radiograph.knee.side


def save_kinds(
    radiograph: Radiograph,
    stem: str | Path,
    kinds: Collection[str],
    *,
    border: str = "none",
    look: str | Processed | Film = "processed",
) -> list[Path]:
    """Write a radiograph in several ways beside each other; returns their paths.

    kinds         of KINDS; "dcm" is two objects, STEM.dcm For Processing and STEM_presentation.dcm
    border, look  as in `save`, of what is for presentation
    raises        InputError for another kind, a file of another radiograph that is there already; as `save`
    """
    for kind in kinds:
        require_choice("formats", kind, KINDS)
    # Before anything is written.
    require_no_other(radiograph, (f"{stem}.{kind}" for kind in kinds))
    if {"png", "dcm"} & set(kinds):
        _side(radiograph, "presentation", border, Path(stem))
    paths = []
    if "tif" in kinds:
        paths.append(save(radiograph, f"{stem}.tif"))
    if "png" in kinds:
        paths.append(save(radiograph, f"{stem}.png", border=border, look=look))
    if "json" in kinds:
        paths.append(save_parameters(radiograph, f"{stem}.json"))
    if "dcm" in kinds:
        paths.append(save(radiograph, f"{stem}.dcm"))
        shown = f"{stem}_presentation.dcm"
        paths.append(save(radiograph, shown, intent="presentation", border=border, look=look))
    return paths


def require_no_other(radiograph: Radiograph, paths: Iterable[str | Path]) -> None:
    """Refuse files that would be written over, and are of another radiograph than this one made again.

    raises  InputError, also for a file that is not by this package
    """
    for path in map(Path, paths):
        if path.exists():
            made = load_parameters(path)
            for name in ("protocol", "knee", "knees", "scene", "surgery", "seed"):
                if made[name] != getattr(radiograph, name):
                    raise InputError(f"file {path}: is there, of another {name}; allowed: another folder, or delete it")


def load(path: str | Path) -> Radiograph:
    """A radiograph from a TIFF or DICOM that `save` wrote: the same pixels, protocol, knee, seed, truth and audit.

    raises  InputError for a file that is missing, not as it was written or not by this package, or a DICOM For
            Presentation, whose pixels are not linear (`load_parameters` reads what it was made from)
    """
    path = require_path(path)
    with reading(path, "a TIFF or DICOM by pssf"):
        _require_own_picture(path, "a TIFF or DICOM For Processing", ("TIFF",))
        pixels, text = _opened(path)
        made = parameters(text, path)
        require_as_written(text, pixels, path)
        size = (made["protocol"].rows, made["protocol"].cols)
        if pixels.shape != size:
            raise InputError(f"file {path}: pixels = {pixels.shape}; allowed: {size}, those of its protocol")
        return Radiograph(pixels=pixels, **made)


def load_parameters(path: str | Path) -> dict[str, Any]:
    """What a radiograph on disk was made from: protocol, knee, knees or scene, surgery, seed, truth or truths, engine,
    audit, versions.

    Of a knee with implants, or of a scene, the file has hashes of the meshes and not the meshes.

    path    what `save` or `save_parameters` wrote, of any suffix and intent
    raises  InputError for a file that is missing, damaged, edited, or not written by this package
    warns   UnverifiedNotice for a PNG, JSON or DICOM For Presentation of an earlier version, which has no hash
    """
    path = require_path(path)
    pixels: NDArray[Any] | None = None
    with reading(path, "a TIFF, DICOM, PNG or JSON by pssf"):
        _require_own_picture(path, "a TIFF, DICOM, PNG or JSON", ("TIFF", "PNG"))
        if path.suffix.lower() == ".json":
            text = read_text(path)
        elif path.suffix.lower() == ".png":
            with Image.open(path) as image:
                text = image.info["Description"]
        elif is_dicom(path):
            from . import dicom

            pixels, text = dicom.opened_parameters(path)
        else:
            pixels, text = _opened(path)
        made = parameters(text, path)
        require_parameters(text, path, pixels)
        return made


def _require_own_picture(path: Path, wanted: str, kinds: tuple[str, ...]) -> None:
    """Refuse a picture that this package did not write, or of another kind than those that are read.

    What is no picture, or a damaged one, is left to the readers.
    raises  InputError that says what reads it
    """
    kind, text = "", ""
    with suppress(Exception), Image.open(path) as image:  # a damaged file can fail anywhere in its reader
        tags = getattr(image, "tag_v2", {})
        kind, text = image.format or "", str(image.info.get("Description", tags.get(_DESCRIPTION, "")))
    if not kind or ('"protocol"' in text and kind in kinds):
        return
    what = f"file must be {wanted} that pssf wrote, got {path}, a {kind}"
    if '"protocol"' in text:
        raise InputError(f"{what} for presentation, without linear pixels: load_parameters reads what it was made from")
    raise InputError(f"{what} from elsewhere: pssf read, pssf.features and pssf study --films read images of your own")


def _opened(path: Path) -> tuple[NDArray[Any], str]:
    """Linear pixels (rows, cols) of a TIFF or DICOM, and the JSON of what they were made from."""
    if is_dicom(path):
        from . import dicom

        return dicom.read(path)
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages[0]
        return page.asarray(), page.description  # type: ignore[union-attr]


def require_radiograph(radiograph: object) -> None:
    """Refuse what is no radiograph.

    raises  InputError
    """
    if not isinstance(radiograph, Radiograph):
        raise InputError(f"radiograph = {radiograph!r}; allowed: a Radiograph, as simulate gives it")


def suffix_of(path: Path, allowed: tuple[str, ...]) -> str:
    """The suffix of a file, in small letters.

    raises  InputError for one that is not allowed
    """
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise InputError(f"file {path}: suffix {suffix!r}; allowed: {', '.join(allowed)}")
    return suffix


@contextmanager
def reading(path: str | Path, allowed: str, fault: str = "damaged or not by pssf") -> Iterator[None]:
    """Whatever goes wrong in a reader of a regular file becomes a refusal of one line that names the file.

    fault   what a file is called that a reader cannot read
    raises  InputError
    """
    try:
        require_file(Path(path), allowed=allowed)
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: {allowed}, readable") from None
    except Exception as error:  # a damaged file can fail anywhere in its reader
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise InputError(f"file {path}: {fault} ({reason}); allowed: {allowed}") from None


def save_parameters(radiograph: Radiograph, path: str | Path) -> Path:
    """Write all that a radiograph was made from as JSON.

    raises  InputError for a disk that is full or cannot be written
    """
    path = require_path(path)
    write_bytes(path, (as_json(radiograph, indent=2) + "\n").encode())
    return path
