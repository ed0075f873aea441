"""Pixels of other sources that are linear in the signal, and whether a file says what its pixels are."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from ..core.checks import InputError, require
from .film_list import PIXEL_MM, require_film
from .image_kind import is_dicom
from .images import load_parameters, reading

_MOST = 65535
_ALLOWED = "one image of linear pixels, 9 to 16 bit, grey"
_BY_PSSF = 305  # tag Software of a TIFF
_SIDES = {"R": "right", "L": "left"}
_SQUARE = 0.01  # by which the height and width of a pixel that is called square may differ


class LinearPixels(NamedTuple):
    """Linear pixels of a file.

    pixels    (rows, cols) air bright, as they are in the file
    pixel_mm  pitch at the detector, where the file says so, as DICOM does
    side      right | left, where the file says so
    """

    pixels: NDArray[np.uint16]
    pixel_mm: float | None = None
    side: str | None = None


def read_linear(path: str | Path) -> LinearPixels:
    """Read pixels that their owner says are linear in the signal, air bright, without any change.

    Parameters
    ----------
    path : str or Path
        TIFF, PNG or DICOM of one grey image of 9 to 16 bit.

    Raises
    ------
    InputError
        The file is missing, damaged, of another kind, in colour, of 8 bit or fewer, of several frames, or a DICOM that
        says that its pixels are logarithms, fall with the signal, or are for presentation.
    """
    path = Path(path)
    require_film(path)
    with reading(path, _ALLOWED, "damaged"):
        found = _dicom(path) if is_dicom(path) else LinearPixels(_picture(path))
        pixels = found.pixels
        if pixels.ndim != 2 or pixels.dtype.kind not in "iu":
            raise InputError(f"file {path}: pixels = {pixels.shape} of {pixels.dtype}; allowed: {_ALLOWED}")
        least, most = int(pixels.min()), int(pixels.max())
        if pixels.dtype.itemsize == 1 or least < 0 or most > _MOST:
            bits = 8 * pixels.dtype.itemsize
            raise InputError(f"file {path}: pixels = {least} to {most} of {bits} bit; allowed: {_ALLOWED}")
        return found._replace(pixels=pixels.astype(np.uint16))


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


def _dicom(path: Path) -> LinearPixels:
    import pydicom  # is not imported before a DICOM is wanted
    from pydicom.pixels import apply_modality_lut

    item = pydicom.dcmread(path)
    for name, refused in (
        ("PresentationIntentType", "FOR PRESENTATION"),
        ("PixelIntensityRelationship", "LOG"),
        ("PixelIntensityRelationshipSign", "-1"),
    ):
        if str(item.get(name) or "") == refused:
            raise InputError(f"file {path}: {name} = {refused}; allowed with linear pixels: any other value")
    values = np.asarray(apply_modality_lut(item.pixel_array, item))
    if values.dtype.kind == "f":
        values = np.rint(values).astype(np.int64)
    pitch = item.get("ImagerPixelSpacing") or item.get("PixelSpacing")
    if pitch:
        down, across = map(float, pitch)
        require(f"file {path}: pixel_mm", across, *PIXEL_MM, "mm")
        if abs(down - across) > _SQUARE * across:
            raise InputError(f"file {path}: pixel = {down:g} by {across:g} mm; allowed: square")
    side = _SIDES.get(str(item.get("ImageLaterality", "") or item.get("Laterality", "")))
    return LinearPixels(values, float(pitch[1]) if pitch else None, side)
