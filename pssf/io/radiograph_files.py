"""Radiograph files: TIFF and DICOM with linear pixels, PNG and DICOM for display, and JSON with parameters.

Every file contains all simulation parameters of the radiograph.
"""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tifffile
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from ..core.checks import InputError, require_choice, require_path
from ..core.keyword_arguments import check_keywords
from ..data.imaging.display_table import FlatPanelProcessing, ScreenFilm, load_display_processing
from ..data.user_files import read_text, require_regular_file
from ..detector import format_processing, render_for_display, resolve_processing
from ..model.radiograph import Radiograph
from .atomic_write import replace_file, write_bytes
from .image_kind import is_dicom
from .metadata import (
    decode_metadata,
    encode_metadata,
    require_intact_metadata,
    require_intact_radiograph,
)

# Allowed values of the parameter `intent` of `save` for each file suffix; the first value is the default.
INTENTS = {
    ".tif": ("processing",),
    ".tiff": ("processing",),
    ".dcm": ("processing", "presentation"),
    ".png": ("presentation",),
}
SUFFIXES = tuple(INTENTS)
BORDERS = ("none", "marked")
# Number of the TIFF tag ImageDescription, which contains the metadata (TIFF 6.0).
_DESCRIPTION_TAG = 270
_MARKER_ALLOWED = "none, except for a presentation image of one knee"
# File formats that `save_formats` can write.
FORMATS = ("tif", "png", "json", "dcm")


@check_keywords(look="processing")
def save(
    radiograph: Radiograph,
    path: str | Path,
    *,
    intent: str | None = None,
    border: str = "none",
    processing: str | FlatPanelProcessing | ScreenFilm = "processed",
) -> Path:
    """Write a radiograph as 16-bit TIFF, 16- or 12-bit DICOM Digital X-Ray, or 8-bit PNG, depending on the file suffix.

    Every file contains all simulation parameters of the radiograph. Identical radiographs yield identical files,
    because DICOM UIDs are derived from the content.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to write.
    path : str or Path
        File to write, with suffix .tif, .tiff, .dcm or .png.
    intent : {"processing", "presentation"} or None
        "processing" writes linear pixels, which `load` can read. "presentation" writes an image with display processing
        and bright bone. The names correspond to the DICOM values For Processing and For Presentation. A .tif file
        requires "processing", a .png file requires "presentation", and a .dcm file allows both. None selects
        "presentation" for .png and "processing" for other suffixes.
    border : {"none", "marked"}
        "marked" adds the collimator edge and the side marker to a presentation image of one knee.
    processing : str, FlatPanelProcessing or ScreenFilm
        Display processing of presentation images: "processed", "log" or "film", or an object with custom parameters;
        see `render_for_display`. The method and its parameters are recorded in the file.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        The suffix, intent, border or display processing is not supported, or the image does not allow a side marker.
        The disk is full, or the file cannot be written.

    See Also
    --------
    load : Read a radiograph with linear pixels.
    load_parameters : Read the parameters from a file of any format.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf, trimesh
    >>> sphere = pssf.Surface(trimesh.creation.icosphere(radius=40.0), "water", "air", "sphere")
    >>> protocol = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(pssf.Scene([sphere]), protocol, rng=0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pssf.save(radiograph, Path(folder) / "sphere.tif")
    ...     pssf.load(path) == radiograph
    True
    """
    path = require_path(path)
    require_radiograph(radiograph)
    suffix = require_suffix(path, SUFFIXES)
    intent = INTENTS[suffix][0] if intent is None else intent
    require_choice(f"file {path}: intent", intent, INTENTS[suffix])
    side, shown_as = (
        _select_marker_side(radiograph, intent, border, path),
        resolve_processing(processing, load_display_processing()),
    )
    with replace_file(path) as temporary:
        if suffix == ".png":
            note = PngImagePlugin.PngInfo()
            note.add_text("Description", encode_metadata(radiograph))
            note.add_text("DisplayProcessing", format_processing(shown_as))
            Image.fromarray(render_for_display(radiograph, side=side, processing=shown_as or "log")).save(
                temporary, format="PNG", pnginfo=note
            )
        elif suffix == ".dcm":
            from .dicom import dicom_radiograph  # pydicom is imported only for DICOM files.

            dicom_radiograph.write_radiograph(
                radiograph, encode_metadata(radiograph), temporary, intent, side, shown_as
            )
        else:
            _write_tiff(radiograph, temporary)
    return path


def _write_tiff(radiograph: Radiograph, path: Path) -> None:
    """Write the pixels of a radiograph and its parameters as a TIFF file."""
    per_cm = float(10.0 / radiograph.protocol.pixel_mm)
    tifffile.imwrite(
        path,
        radiograph.pixels,
        photometric="minisblack",
        # Deflate of the differences between neighbouring pixels, which ITK and ImageJ can read. Higher levels
        # take longer and save 2 %, because quantum noise limits the compression.
        compression="zlib",
        compressionargs={"level": 1},
        predictor=True,
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        software=f"pssf {version('pssf')}",
        # tifffile misinterprets JSON with the text "shape": as tifffile metadata. A space before the colon
        # prevents the misinterpretation.
        description=encode_metadata(radiograph).replace('"shape":', '"shape" :'),
        metadata=None,
    )


def _select_marker_side(radiograph: Radiograph, intent: str, border: str, path: Path) -> str | None:
    """Return the knee side for the drawn side marker of a presentation image, or None for no marker."""
    require_choice(f"file {path}: border", border, BORDERS)
    if border == "none":
        return None
    if intent != "presentation" or radiograph.knee is None:
        raise InputError(f"file {path}: border must be {_MARKER_ALLOWED}, got {border!r}")
    return radiograph.knee.side


def save_formats(
    radiograph: Radiograph,
    stem: str | Path,
    formats: Collection[str],
    *,
    border: str = "none",
    processing: str | FlatPanelProcessing | ScreenFilm = "processed",
) -> list[Path]:
    """Write a radiograph in several formats, to files that differ only in the suffix.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to write.
    stem : str or Path
        Path of the files, without suffix.
    formats : collection of str
        One or more of "tif", "png", "json" and "dcm". The format "dcm" writes two files: STEM.dcm (For Processing) and
        STEM_presentation.dcm (For Presentation).
    border : {"none", "marked"}
        Border of the presentation images; see `save`.
    processing : str, FlatPanelProcessing or ScreenFilm
        Display processing of presentation images: "processed", "log" or "film", or an object with custom parameters;
        see `render_for_display`.

    Returns
    -------
    list of Path
        Paths of the written files.

    Raises
    ------
    InputError
        A format is not supported, a file with another radiograph exists, or `save` raises an InputError.
    """
    for kind in formats:
        require_choice("formats", kind, FORMATS)
    # All arguments are validated before the first file is written.
    require_no_other_radiograph(radiograph, (f"{stem}.{kind}" for kind in formats))
    if {"png", "dcm"} & set(formats):
        _select_marker_side(radiograph, "presentation", border, Path(stem))
    paths = []
    if "tif" in formats:
        paths.append(save(radiograph, f"{stem}.tif"))
    if "png" in formats:
        paths.append(save(radiograph, f"{stem}.png", border=border, processing=processing))
    if "json" in formats:
        paths.append(save_parameters(radiograph, f"{stem}.json"))
    if "dcm" in formats:
        paths.append(save(radiograph, f"{stem}.dcm"))
        shown = f"{stem}_presentation.dcm"
        paths.append(save(radiograph, shown, intent="presentation", border=border, processing=processing))
    return paths


def require_no_other_radiograph(radiograph: Radiograph, paths: Iterable[str | Path]) -> None:
    """Require that existing files contain the same radiograph, so that no other radiograph is overwritten.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to write.
    paths : iterable of str or Path
        Paths of the files to write. Paths without an existing file are skipped.

    Raises
    ------
    InputError
        A file contains another radiograph, or was not written by PSSF.
    """
    for path in map(Path, paths):
        if path.exists():
            made = load_parameters(path)
            for name in ("protocol", "knee", "knees", "scene", "surgery", "seed"):
                if made[name] != getattr(radiograph, name):
                    raise InputError(
                        f"file {path} must contain the same radiograph, got another {name}: delete the file"
                    )


def load(path: str | Path) -> Radiograph:
    """Read a radiograph with linear pixels and all parameters from a TIFF or DICOM file that `save` wrote.

    Parameters
    ----------
    path : str or Path
        File to read.

    Returns
    -------
    Radiograph
        Radiograph with pixels, protocol, knee, seed, ground truth and audit. Masks are read by `load_masks`.

    Raises
    ------
    InputError
        The file is missing, damaged, altered or not written by PSSF, or the file is a DICOM For Presentation image,
        whose pixels are not linear.

    See Also
    --------
    save : Write a radiograph.
    load_parameters : Read the parameters from a file of any format, including presentation images.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf, trimesh
    >>> sphere = pssf.Surface(trimesh.creation.icosphere(radius=40.0), "water", "air", "sphere")
    >>> protocol = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(pssf.Scene([sphere]), protocol, rng=0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pssf.save(radiograph, Path(folder) / "sphere.dcm")
    ...     loaded = pssf.load(path)
    >>> loaded.pixels.shape, loaded.seed
    ((64, 64), 0)
    """
    path = require_path(path)
    with convert_read_errors(path, "a TIFF or DICOM file written by pssf"):
        _require_own_image(path, "a TIFF or DICOM For Processing", ("TIFF",))
        pixels, text = _read_linear_and_metadata(path)
        made = decode_metadata(text, path)
        require_intact_radiograph(text, pixels, path)
        size = (made["protocol"].rows, made["protocol"].cols)
        if pixels.shape != size:
            raise InputError(f"file {path}: shape of pixels must be {size}, as in the protocol, got {pixels.shape}")
        return Radiograph(pixels=pixels, **made)


def load_parameters(path: str | Path) -> dict[str, Any]:
    """Read the simulation parameters of a radiograph from a file.

    Parameters
    ----------
    path : str or Path
        File that `save` or `save_parameters` wrote, with any suffix and intent.

    Returns
    -------
    dict of str to object
        Fields of `Radiograph` except pixels, keyed by field name: protocol, knee, knees, scene, surgery, seed,
        truth, truths, engine, audit and versions. For meshes of implants and scenes, the file contains only hashes.

    Raises
    ------
    InputError
        The file is missing, damaged, altered or not written by PSSF.

    Warns
    -----
    UnverifiedNotice
        An earlier version wrote the file (PNG, JSON or DICOM For Presentation) without a hash.

    See Also
    --------
    load : Read a radiograph with its linear pixels.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf, trimesh
    >>> sphere = pssf.Surface(trimesh.creation.icosphere(radius=40.0), "water", "air", "sphere")
    >>> protocol = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(pssf.Scene([sphere]), protocol, rng=0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pssf.save(radiograph, Path(folder) / "sphere.png")
    ...     parameters = pssf.load_parameters(path)
    >>> parameters["protocol"] == protocol, parameters["seed"]
    (True, 0)
    """
    path = require_path(path)
    pixels: NDArray[Any] | None = None
    with convert_read_errors(path, "a TIFF, DICOM, PNG or JSON file written by pssf"):
        _require_own_image(path, "a TIFF, DICOM, PNG or JSON", ("TIFF", "PNG"))
        if path.suffix.lower() == ".json":
            text = read_text(path)
        elif path.suffix.lower() == ".png":
            with Image.open(path) as image:
                text = image.info["Description"]
        elif is_dicom(path):
            from .dicom import dicom_radiograph

            pixels, text = dicom_radiograph.read_metadata(path)
        else:
            pixels, text = _read_linear_and_metadata(path)
        made = decode_metadata(text, path)
        require_intact_metadata(text, path, pixels)
        return made


def _require_own_image(path: Path, wanted: str, kinds: tuple[str, ...]) -> None:
    """Require that PSSF wrote an image, and that the image format is one of `kinds`.

    Damaged files and files that are not images are not rejected, because the readers report these files later. The
    InputError contains the function or command that can read the image.
    """
    kind, text = "", ""
    with suppress(Exception), Image.open(path) as image:  # Reading a damaged file can raise any exception.
        tags = getattr(image, "tag_v2", {})
        kind, text = image.format or "", str(image.info.get("Description", tags.get(_DESCRIPTION_TAG, "")))
    if not kind or ('"protocol"' in text and kind in kinds):
        return
    what = f"file {path} must be {wanted} file written by pssf, got a {kind}"
    if '"protocol"' in text:
        raise InputError(f"{what} for presentation, which has no linear pixels: use load_parameters for the parameters")
    raise InputError(f"{what} of another program: use pssf predict, pssf.features or pssf study --films")


def _read_linear_and_metadata(path: Path) -> tuple[NDArray[Any], str]:
    """Read the linear pixels (rows, cols) in DN and the JSON metadata from a TIFF or DICOM file."""
    if is_dicom(path):
        from .dicom import dicom_radiograph

        return dicom_radiograph.read_linear_radiograph(path)
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages[0]
        return page.asarray(), page.description  # type: ignore[union-attr]


def require_radiograph(radiograph: object) -> None:
    """Require that an object is a Radiograph.

    Parameters
    ----------
    radiograph : object
        Object to check.

    Raises
    ------
    InputError
        The object is not a Radiograph.
    """
    if not isinstance(radiograph, Radiograph):
        raise InputError(f"radiograph must be a Radiograph, as returned by simulate, got {radiograph!r}")


def require_suffix(path: Path, allowed: tuple[str, ...]) -> str:
    """Require that a file has an allowed suffix.

    Parameters
    ----------
    path : Path
        File to check.
    allowed : tuple of str
        Allowed suffixes in lower case, including the dot.

    Returns
    -------
    str
        Suffix in lower case, including the dot.

    Raises
    ------
    InputError
        The suffix is not allowed.
    """
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise InputError(f"file {path}: suffix must be one of {', '.join(allowed)}, got {suffix!r}")
    return suffix


@contextmanager
def convert_read_errors(
    path: str | Path, allowed: str, fault: str = "damaged or not written by pssf"
) -> Iterator[None]:
    """Convert any exception during reading of a file to a one-line InputError that contains the path.

    Parameters
    ----------
    path : str or Path
        File that the ``with`` block reads. Error messages contain the path.
    allowed : str
        Description of a valid file, such as "a TIFF or DICOM file written by pssf".
    fault : str
        Description of an unreadable file, such as "damaged".

    Yields
    ------
    None
        No value. The ``with`` block must read the file.

    Raises
    ------
    InputError
        The path is not a regular file, or the ``with`` block raises an exception.
    """
    try:
        require_regular_file(Path(path), allowed=allowed)
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"file {path} must be {allowed} and readable, got {error.strerror or error}") from None
    except Exception as error:  # Reading a damaged file can raise any exception.
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise InputError(f"file {path} must be {allowed}, got a file that is {fault} ({reason})") from None


def save_parameters(radiograph: Radiograph, path: str | Path) -> Path:
    """Write all simulation parameters of a radiograph as JSON.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph with the parameters to write.
    path : str or Path
        File to write.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    path = require_path(path)
    write_bytes(path, (encode_metadata(radiograph, indent=2) + "\n").encode())
    return path
