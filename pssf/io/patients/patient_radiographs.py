"""Read a patient radiograph in any supported image format, and process its pixels for display."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from ...core.checks import (
    Array,
    InputError,
    require_choice,
    require_integer,
)
from ...data.imaging.display_table import FlatPanelProcessing
from ...detector import render_for_display
from ..image_kind import SUFFIXES, is_dicom
from ..radiograph_files import convert_read_errors, load, load_parameters
from .packed_tiff import read_packed_tiff
from .patient_list import (
    PIXEL_MM_RANGE,
    SIDES,
    Film,
    list_films,
    parse_subject_and_side,
    require_film,
)

__all__ = ["SIDES", "SUFFIXES", "Film", "FilmImage", "list_films", "parse_subject_and_side", "read_film"]

# Smallest number of rows or columns of an image; for a field 100 mm wide, 64 pixels are about 1.5 mm each.
MIN_SIDE_PX = 64
# Number of grey values in each Pillow image mode.
_GREY_LEVELS = {"L": 2**8, "I;16": 2**16, "I;16L": 2**16, "I;16B": 2**16, "I;16N": 2**16}
_COLOUR_MODES = ("P", "PA", "LA", "RGB", "RGBA")
# Largest difference between the colour channels of a grey image, as a fraction of the largest grey value. The colour
# transform of JPEG rounds the channels, so equal channels may differ after decoding.
_MAX_CHANNEL_SPREAD = 8 / 255
_WHITE_IS_ZERO = 0  # value of the tag PhotometricInterpretation
_PHOTOMETRIC = 262  # number of the tag PhotometricInterpretation (TIFF 6.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmImage:
    """Radiograph with pixels processed for display.

    Attributes
    ----------
    pixels : (rows, cols) array
        Grey values from 0 to 1 (largest value of the bit depth). Bone is bright, unless the file stores an inverted
        image without declaring the inversion.
    pixel_mm : float or None
        Pixel size at the detector, in mm; None if unknown. Only DICOM files and files from this package specify it; the
        resolution in other files refers to printing.
    side : {"right", "left"} or None
        Knee side; None if the file does not specify it.
    """

    pixels: Array
    pixel_mm: float | None = None
    side: str | None = None


def read_film(path: str | Path, processing: FlatPanelProcessing | None = None) -> FilmImage:
    """Read a radiograph; apply display processing to linear pixels and to log-converted pixels.

    Parameters
    ----------
    path : str or Path
        PNG, JPEG, TIFF or DICOM file with 8 to 16 bits. The channels of a colour image must be equal.
    processing : FlatPanelProcessing or None
        Display processing of linear pixels; None uses the display preset "processed".

    Returns
    -------
    FilmImage
        Image processed for display.

    Raises
    ------
    InputError
        The file is missing, empty, damaged, or not an image. The image is coloured or too small, or has several frames,
        a single grey value, or non-square pixels. A For Processing DICOM does not state how its pixel values depend on
        the detector signal.
    """
    path = Path(path)
    require_film(path)
    with convert_read_errors(path, "a readable radiograph with 8 to 16 bits", "damaged"):
        if path.stat().st_size == 0:
            raise InputError(f"file {path} must be a radiograph, got an empty file")
        if is_dicom(path):
            from . import patient_dicom  # pydicom is imported only for DICOM files.

            ours = patient_dicom.is_own_linear_dicom(path)
            film = (
                _render_own_radiograph(path, processing)
                if ours
                else FilmImage(**patient_dicom.read_dicom_film(path, PIXEL_MM_RANGE, processing))
            )
        else:
            packed = read_packed_tiff(path) if path.suffix.lower() in (".tif", ".tiff") else None
            film = _read_picture(path, processing) if packed is None else FilmImage(pixels=packed)
    for name, length in zip(("rows", "columns"), film.pixels.shape, strict=True):
        require_integer(f"file {path}: {name}", length, MIN_SIDE_PX, 2**16, "pixels")
    least, most = float(film.pixels.min()), float(film.pixels.max())
    if not most > least:
        raise InputError(f"file {path} must have more than one grey value, got {least:g} in all pixels")
    return film


def _render_own_radiograph(path: Path, processing: FlatPanelProcessing | None) -> FilmImage:
    """Apply display processing to the linear pixels of a radiograph that this package wrote."""
    radiograph = load(path)
    shown = render_for_display(radiograph, bits=16, processing=processing or "processed")
    side = None if radiograph.knee is None else radiograph.knee.side
    return FilmImage(pixels=shown / 65535.0, pixel_mm=radiograph.protocol.pixel_mm, side=side)


def _read_picture(path: Path, processing: FlatPanelProcessing | None) -> FilmImage:
    """Read a PNG, JPEG or TIFF, and process its pixels for display."""
    with _open_picture(path) as image:
        frames = getattr(image, "n_frames", 1)
        if frames > 1:
            raise InputError(f"file {path}: frames must be 1, got {frames}")
        if "pssf" in str(getattr(image, "tag_v2", {}).get(305, "")):
            return _render_own_radiograph(path, processing)
        said: dict[str, Any] = _read_own_metadata(path) if "Description" in image.info else {}
        upright = ImageOps.exif_transpose(image)
        pixels = _convert_to_grey(np.asarray(_remove_palette(upright, path)), upright.mode, path)
        # Pillow inverts 8-bit white-is-zero images, but not 16-bit white-is-zero images.
        if image.mode != "L" and getattr(image, "tag_v2", {}).get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
            pixels = 1.0 - pixels
    return FilmImage(pixels=pixels, **said)


def _open_picture(path: Path) -> Image.Image:
    """Open an image and load its pixels."""
    image = None
    try:
        image = Image.open(path)
        image.load()
        return image
    except OSError as error:  # Pillow raises OSError for damaged files and for files that are not images.
        if image is not None:
            image.close()
        if error.errno is not None:
            raise
        raise InputError(
            f"file {path} must be a readable radiograph with 8 to 16 bits, got a file that is damaged or not an image"
        ) from None


def _read_own_metadata(path: Path) -> dict[str, Any]:
    """Read the pixel size and knee side from an image that this package wrote; return {} for other images."""
    try:
        made = load_parameters(path)
    except InputError:
        return {}
    return {"pixel_mm": made["protocol"].pixel_mm, "side": None if made["knee"] is None else made["knee"].side}


def _remove_palette(image: Image.Image, path: Path) -> Image.Image:
    """Convert a colour or palette image to RGBA; return a grey image unchanged."""
    require_choice(f"file {path}: pixel format", image.mode, (*_GREY_LEVELS, *_COLOUR_MODES))
    return image.convert("RGBA") if image.mode in _COLOUR_MODES else image


def _convert_to_grey(values: NDArray[Any], mode: str, path: Path) -> Array:
    """Convert grey values, or equal colour channels, to an array (rows, cols) from 0 to 1."""
    if mode in _GREY_LEVELS:
        return values.astype(np.float64) / (_GREY_LEVELS[mode] - 1)
    shown = values.astype(np.float64) / 255.0
    if shown[..., 3].min() < 1.0:
        raise InputError(f"file {path}: opacity must be 1 in all pixels, got a minimum of {shown[..., 3].min():.2f}")
    spread = float(np.ptp(shown[..., :3], axis=2).max())
    if spread > _MAX_CHANNEL_SPREAD:
        raise InputError(
            f"file {path}: colour channels must differ by at most {_MAX_CHANNEL_SPREAD:.2f}, got {spread:.2f}"
        )
    return np.asarray(shown[..., :3].mean(axis=2))
