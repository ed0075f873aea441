"""Read the stored pixel values of image files, and detect whether a file declares the meaning of its pixels."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from ...core.checks import InputError, require_in_range
from ..image_kind import is_dicom
from ..radiograph_files import convert_read_errors, load_parameters
from .patient_list import PIXEL_MM_RANGE, require_film

# Smallest value of int16 and largest value of uint16, the limits of stored values.
_LEAST = -32768
_MOST = 65535
_ALLOWED_STORED = "one grey image of 8 to 16 bit"
_ALLOWED_LINEAR = "one image of linear pixels, 9 to 16 bit, grey"
_SOFTWARE_TAG = 305  # TIFF 6.0: tag Software
# Values of DICOM attributes that state that pixels are not linear in the signal.
_NONLINEAR_VALUES = {
    "PresentationIntentType": "FOR PRESENTATION",
    "PixelIntensityRelationship": "LOG",
    "PixelIntensityRelationshipSign": "-1",
}
_SIDES = {"R": "right", "L": "left"}
_SQUARE_TOLERANCE = 0.01  # largest relative difference between height and width of a square pixel


class StoredPixels(NamedTuple):
    """Pixel values as stored in a file.

    Attributes
    ----------
    pixels : (rows, cols) integer array
        Stored values, without unit.
    pixel_mm : float or None
        Pixel size at the detector, in mm; None if the file gives none. Only DICOM gives
        it.
    side : {"right", "left"} or None
        Side of the knee; None if the file gives none.
    dicom_attributes : dict of str to str
        DICOM attributes that state the meaning of the pixels; empty for other files.
    """

    pixels: NDArray[Any]
    pixel_mm: float | None = None
    side: str | None = None
    dicom_attributes: Mapping[str, str] = MappingProxyType({})


def read_stored_pixels(path: str | Path) -> StoredPixels:
    """Read pixel values as stored in a file, without display processing; rescale the values of a DICOM.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG, JPEG or DICOM with one grey image of 8 to 16 bit.

    Returns
    -------
    StoredPixels
        Stored values.

    Raises
    ------
    InputError
        The file is missing, damaged, or not an image. The image has colour, several frames, or values that are not
        whole numbers from -32768 to 65535.
    """
    path = Path(path)
    require_film(path)
    with convert_read_errors(path, _ALLOWED_STORED, "damaged"):
        stored = _read_dicom(path) if is_dicom(path) else StoredPixels(_read_picture(path))
        pixels = stored.pixels
        if pixels.ndim != 2 or pixels.dtype.kind not in "iub":
            raise InputError(f"file {path} must be {_ALLOWED_STORED}, got {pixels.shape} of {pixels.dtype}")
        least, most = int(pixels.min()), int(pixels.max())
        if not _LEAST <= least <= most <= _MOST:
            raise InputError(f"file {path}: pixels must be {_LEAST} to {_MOST}, got {least} to {most}")
        return stored


def read_linear_pixels(path: str | Path) -> StoredPixels:
    """Read pixels that the user declares to be linear in the signal, with air bright.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG or DICOM with one grey image of 9 to 16 bit.

    Returns
    -------
    StoredPixels
        Unchanged pixels as uint16.

    Raises
    ------
    InputError
        `read_stored_pixels` raises an InputError. The file has 8 bits or fewer, or negative values. A DICOM states that
        its pixels are logarithms, decrease with the signal, or are For Presentation.
    """
    path = Path(path)
    stored = read_stored_pixels(path)
    bits = 8 * stored.pixels.dtype.itemsize
    if bits == 8 or int(stored.pixels.min()) < 0:
        least, most = int(stored.pixels.min()), int(stored.pixels.max())
        raise InputError(f"file {path} must be {_ALLOWED_LINEAR}, got values {least} to {most} of {bits} bits")
    for name, refused in _NONLINEAR_VALUES.items():
        if stored.dicom_attributes.get(name, "") == refused:
            raise InputError(f"file {path}: {name} must state linear pixels, got {refused}")
    return stored._replace(pixels=stored.pixels.astype(np.uint16))


def has_declared_pixel_meaning(path: Path) -> bool:
    """Return whether a file declares its pixels to be linear or displayed.

    Parameters
    ----------
    path : Path
        File to check.

    Returns
    -------
    bool
        True for DICOM, for files of this package, and for images of 8 bits, whose pixels are as displayed.
    """
    if is_dicom(path):
        return True
    try:
        with Image.open(path) as image:
            if not image.mode.startswith("I") and image.mode != "F":
                return True
            if "pssf" in str(getattr(image, "tag_v2", {}).get(_SOFTWARE_TAG, "")):
                return True
            if "Description" not in image.info:
                return False
        load_parameters(path)
        return True
    except (OSError, InputError):
        return False


def _read_picture(path: Path) -> NDArray[Any]:
    """Read the stored values of a TIFF, PNG or JPEG."""
    if path.suffix.lower() in (".tif", ".tiff"):
        with tifffile.TiffFile(path) as tiff:
            if len(tiff.pages) > 1:
                raise InputError(f"file {path} must be {_ALLOWED_LINEAR}, got {len(tiff.pages)} frames")
            return np.asarray(tiff.pages[0].asarray())
    with Image.open(path) as image:
        pixels = np.asarray(image)
        return pixels.astype(np.uint16) if image.mode.startswith("I") else pixels


def _read_dicom(path: Path) -> StoredPixels:
    """Read the rescaled values of a DICOM, its pixel size and side, and the attributes that state their meaning."""
    import pydicom  # pydicom is only imported for DICOM files.
    from pydicom.pixels import apply_modality_lut

    from ..dicom.dicom_pixels import decode_pixels, remove_empty_attributes

    item = remove_empty_attributes(pydicom.dcmread(path))
    values = np.asarray(apply_modality_lut(decode_pixels(item, path), item))
    if values.dtype.kind == "f":
        values = np.rint(values).astype(np.int64)
    pitch = item.get("ImagerPixelSpacing") or item.get("PixelSpacing")
    if pitch:
        down, across = map(float, pitch)
        require_in_range(f"file {path}: pixel_mm", across, *PIXEL_MM_RANGE, "mm")
        if abs(down - across) > _SQUARE_TOLERANCE * across:
            raise InputError(f"file {path}: pixels must be square, got {down:g} by {across:g} mm")
    side = _SIDES.get(str(item.get("ImageLaterality", "") or item.get("Laterality", "")))
    said = {name: str(item.get(name) or "") for name in _NONLINEAR_VALUES}
    return StoredPixels(values, float(pitch[1]) if pitch else None, side, said)
