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

# Limits of stored pixel values: smallest int16 value and largest uint16 value.
_LEAST = -32768
_MOST = 65535
_ALLOWED_STORED = "one grey image with 8 to 16 bits"
_ALLOWED_LINEAR = "one grey image with linear pixels of 9 to 16 bits"
_SOFTWARE_TAG = 305  # number of the tag Software (TIFF 6.0)
# DICOM attribute values that declare pixel values as not proportional to the detector signal.
_NONLINEAR_VALUES = {
    "PresentationIntentType": "FOR PRESENTATION",
    "PixelIntensityRelationship": "LOG",
    "PixelIntensityRelationshipSign": "-1",
}
_SIDES = {"R": "right", "L": "left"}
_SQUARE_TOLERANCE = 0.01  # largest relative difference between the height and width of a square pixel


class StoredPixels(NamedTuple):
    """Pixel values as stored in a file, with their metadata.

    Attributes
    ----------
    pixels : (rows, cols) integer array
        Stored values, dimensionless.
    pixel_mm : float or None
        Pixel size at the detector, in mm; None if unknown. Only DICOM files specify it.
    side : {"right", "left"} or None
        Knee side; None if the file does not specify it.
    dicom_attributes : dict of str to str
        DICOM attributes that specify how pixel values depend on the detector signal; empty for other file formats.
    """

    pixels: NDArray[Any]
    pixel_mm: float | None = None
    side: str | None = None
    dicom_attributes: Mapping[str, str] = MappingProxyType({})


def read_stored_pixels(path: str | Path) -> StoredPixels:
    """Read the pixel values that a file stores, without display processing; apply the modality rescale of a DICOM.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG, JPEG or DICOM file that contains one grey image with 8 to 16 bits.

    Returns
    -------
    StoredPixels
        Stored pixel values, pixel size, knee side and DICOM attributes.

    Raises
    ------
    InputError
        If the file is missing, damaged, or not an image, or if the image has colour, several frames, or values that are
        not integers from -32768 to 65535.
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
            raise InputError(f"file {path}: pixel values must be {_LEAST} to {_MOST}, got {least} to {most}")
        return stored


def read_linear_pixels(path: str | Path) -> StoredPixels:
    """Read pixels that the user declares as linear in the detector signal, with bright air.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG or DICOM file that contains one grey image with 9 to 16 bits.

    Returns
    -------
    StoredPixels
        Stored pixel values, converted to uint16 without scaling.

    Raises
    ------
    InputError
        If the file is rejected by `read_stored_pixels`, has 8 or fewer bits per pixel, or contains negative values. The
        error is also raised if a DICOM file declares its pixel values to be log-converted, to decrease with increasing
        signal, or to be For Presentation.
    """
    path = Path(path)
    stored = read_stored_pixels(path)
    bits = 8 * stored.pixels.dtype.itemsize
    if bits == 8 or int(stored.pixels.min()) < 0:
        least, most = int(stored.pixels.min()), int(stored.pixels.max())
        raise InputError(f"file {path} must be {_ALLOWED_LINEAR}, got values {least} to {most} of {bits} bits")
    for name, refused in _NONLINEAR_VALUES.items():
        if stored.dicom_attributes.get(name, "") == refused:
            raise InputError(f"file {path}: {name} must declare linear pixels, got {refused}")
    return stored._replace(pixels=stored.pixels.astype(np.uint16))


def has_declared_pixel_meaning(path: Path) -> bool:
    """Return whether a file declares its pixels as linear or as processed for display.

    Parameters
    ----------
    path : Path
        File to check.

    Returns
    -------
    bool
        True for DICOM files, for files from this package, and for 8-bit images, which are assumed to be processed for
        display.
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
    """Read the stored pixel values of a TIFF, PNG or JPEG file."""
    if path.suffix.lower() in (".tif", ".tiff"):
        with tifffile.TiffFile(path) as tiff:
            if len(tiff.pages) > 1:
                raise InputError(f"file {path} must be {_ALLOWED_LINEAR}, got {len(tiff.pages)} frames")
            return np.asarray(tiff.pages[0].asarray())
    with Image.open(path) as image:
        pixels = np.asarray(image)
        return pixels.astype(np.uint16) if image.mode.startswith("I") else pixels


def _read_dicom(path: Path) -> StoredPixels:
    """Read the rescaled pixel values, pixel size, knee side and pixel intensity attributes of a DICOM file."""
    import pydicom  # pydicom is imported only for DICOM files.
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
