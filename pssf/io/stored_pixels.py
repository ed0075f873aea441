"""Grey values of files of any source as they are stored, and whether a file says what its pixels are."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from ..core.checks import InputError, require
from .film_list import PIXEL_MM, require_film
from .image_kind import is_dicom
from .images import load_parameters, reading

_LEAST, _MOST = -32768, 65535
_GREY = "one grey image of 8 to 16 bit"
_ALLOWED = "one image of linear pixels, 9 to 16 bit, grey"
_BY_PSSF = 305  # tag Software of a TIFF
# Attribute of a DICOM -> value by which its pixels are not linear in the signal.
_NOT_LINEAR = {
    "PresentationIntentType": "FOR PRESENTATION",
    "PixelIntensityRelationship": "LOG",
    "PixelIntensityRelationshipSign": "-1",
}
_SIDES = {"R": "right", "L": "left"}
_SQUARE = 0.01  # by which the height and width of a pixel that is called square may differ


class StoredPixels(NamedTuple):
    """Pixels of a file as it holds them.

    pixels    (rows, cols) whole numbers
    pixel_mm  pitch at the detector, where the file says so, as DICOM does
    side      right | left, where the file says so
    said      what a DICOM says its pixels are: attribute -> value
    """

    pixels: NDArray[Any]
    pixel_mm: float | None = None
    side: str | None = None
    said: Mapping[str, str] = MappingProxyType({})


def read_values(path: str | Path) -> StoredPixels:
    """Read grey values as a file holds them, without any display; of a DICOM after its rescale, as stored values are.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG, JPEG or DICOM of one grey image of 8 to 16 bit.

    Raises
    ------
    InputError
        The file is missing, damaged, of another kind, in colour, of several frames, or of values that are not whole
        numbers from -32768 to 65535.
    """
    path = Path(path)
    require_film(path)
    with reading(path, _GREY, "damaged"):
        stored = _dicom(path) if is_dicom(path) else StoredPixels(_picture(path))
        pixels = stored.pixels
        if pixels.ndim != 2 or pixels.dtype.kind not in "iub":
            raise InputError(f"file {path}: pixels = {pixels.shape} of {pixels.dtype}; allowed: {_GREY}")
        least, most = int(pixels.min()), int(pixels.max())
        if not _LEAST <= least <= most <= _MOST:
            raise InputError(f"file {path}: pixels = {least} to {most}; allowed: {_LEAST} to {_MOST}")
        return stored


def read_linear(path: str | Path) -> StoredPixels:
    """Read pixels that their owner says are linear in the signal, air bright, without any change.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG or DICOM of one grey image of 9 to 16 bit.

    Raises
    ------
    InputError
        As `read_values`; the file is of 8 bit or fewer or has values below zero, or a DICOM says that its pixels are
        logarithms, fall with the signal, or are for presentation.
    """
    path = Path(path)
    stored = read_values(path)
    bits = 8 * stored.pixels.dtype.itemsize
    if bits == 8 or int(stored.pixels.min()) < 0:
        least, most = int(stored.pixels.min()), int(stored.pixels.max())
        raise InputError(f"file {path}: pixels = {least} to {most} of {bits} bit; allowed: {_ALLOWED}")
    for name, refused in _NOT_LINEAR.items():
        if stored.said.get(name, "") == refused:
            raise InputError(f"file {path}: {name} = {refused}; allowed with linear pixels: any other value")
    return stored._replace(pixels=stored.pixels.astype(np.uint16))


def says_what_pixels_are(path: Path) -> bool:
    """Tell whether a file says that it is a display or linear: DICOM and files of this package; 8 bit are displays."""
    if is_dicom(path):
        return True
    try:
        with Image.open(path) as image:
            if not image.mode.startswith("I") and image.mode != "F":
                return True
            if "pssf" in str(getattr(image, "tag_v2", {}).get(_BY_PSSF, "")):
                return True
            if "Description" not in image.info:
                return False
        load_parameters(path)
        return True
    except (OSError, InputError):
        return False


def _picture(path: Path) -> NDArray[Any]:
    if path.suffix.lower() in (".tif", ".tiff"):
        with tifffile.TiffFile(path) as tiff:
            if len(tiff.pages) > 1:
                raise InputError(f"file {path}: frames = {len(tiff.pages)}; allowed: {_ALLOWED}")
            return np.asarray(tiff.pages[0].asarray())
    with Image.open(path) as image:
        pixels = np.asarray(image)
        return pixels.astype(np.uint16) if image.mode.startswith("I") else pixels


def _dicom(path: Path) -> StoredPixels:
    import pydicom  # is not imported before a DICOM is wanted
    from pydicom.pixels import apply_modality_lut

    from .dicom_pixels import pixels_of, without_empty

    item = without_empty(pydicom.dcmread(path))
    values = np.asarray(apply_modality_lut(pixels_of(item, path), item))
    if values.dtype.kind == "f":
        values = np.rint(values).astype(np.int64)
    pitch = item.get("ImagerPixelSpacing") or item.get("PixelSpacing")
    if pitch:
        down, across = map(float, pitch)
        require(f"file {path}: pixel_mm", across, *PIXEL_MM, "mm")
        if abs(down - across) > _SQUARE * across:
            raise InputError(f"file {path}: pixel = {down:g} by {across:g} mm; allowed: square")
    side = _SIDES.get(str(item.get("ImageLaterality", "") or item.get("Laterality", "")))
    said = {name: str(item.get(name) or "") for name in _NOT_LINEAR}
    return StoredPixels(values, float(pitch[1]) if pitch else None, side, said)
