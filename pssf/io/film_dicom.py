"""DICOM films of any maker, as they are displayed."""

from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import FileDataset
from pydicom.pixels import apply_modality_lut, apply_voi_lut

from ..core.checks import Array, InputError, require, require_choice
from ..data.dicom import dicom_tables
from ..data.looks import Processed, looks
from ..detector.looks import processed
from .dicom_pixels import padding_of, pixels_of, tidied

_SIDES = {"R": "right", "L": "left"}
# Rows and columns of a pixel that is called square.
_SQUARE = 0.01
_PRESENTATION, _PROCESSING = "FOR PRESENTATION", "FOR PROCESSING"
# Grey values that linear pixels are laid out over before their logarithm is taken, as a panel of 16 bit has them.
_GREYS = 2.0**16 - 1


def is_linear_by_pssf(path: Path) -> bool:
    """Whether a DICOM file is For Processing, by this package; whatever pydicom raises for one that it cannot read."""
    item = pydicom.dcmread(path, stop_before_pixels=True)
    wanted = dicom_tables()
    ours = str(item.get("Manufacturer", "")) == wanted.every["Manufacturer"]
    return ours and item.get("PresentationIntentType") == wanted.processing["PresentationIntentType"]


def read(path: Path, allowed_mm: tuple[float, float], look: Processed | None) -> dict[str, Any]:
    """Pixels (rows, cols) 0 to 1 as displayed, bone bright, with pixel_mm and side where the file says so.

    allowed_mm  least and greatest pitch
    look        that linear pixels are shown with; None: the usual one
    raises      InputError for several frames, colour, a pitch that is no square, pixels For Processing of which it is
                not said how they hang on the beam; whatever pydicom raises
    """
    item = tidied(pydicom.dcmread(path), path)
    frames = int(item.get("NumberOfFrames", 1) or 1)
    if frames > 1:
        raise InputError(f"file {path}: frames = {frames}; allowed: 1")
    kind = str(item.get("PhotometricInterpretation", ""))
    require_choice(f"file {path}: PhotometricInterpretation", kind, ("MONOCHROME1", "MONOCHROME2"))
    intent = str(item.get("PresentationIntentType", ""))
    require_choice(f"file {path}: PresentationIntentType", intent, ("", _PRESENTATION, _PROCESSING))
    pixel_mm = _pixel_mm(item, path, allowed_mm)
    if intent == _PROCESSING:
        pixels = _processed(item, path, pixel_mm, look or looks().processed)
    else:
        stored = pixels_of(item, path)
        shown = _displayed(item, stored)
        # Either says the same of what the least value is shown as (PS3.3, C.8.11.3.1.2 and C.11.6.1.2).
        inverse = kind == "MONOCHROME1" or str(item.get("PresentationLUTShape", "")) == "INVERSE"
        pixels = np.where(padding_of(item, stored), 0.0, 1.0 - shown if inverse else shown)
    side = _SIDES.get(str(item.get("ImageLaterality", "") or item.get("Laterality", "")))
    return {"pixels": pixels, "pixel_mm": pixel_mm, "side": side}


def _processed(item: FileDataset, path: Path, pixel_mm: float | None, look: Processed) -> Array:
    """(rows, cols) 0 to 1, bone bright, of pixels For Processing; a window, which the standard forbids there, is left.

    Whether bone is bright is said by the sign of the relationship and not by the photometric interpretation (DICOM
    PS3.3, C.8.11.3.1.2). A rescale that keeps zero and order keeps the relationship; another may undo it.
    """
    relationship, sign = (item.get(f"PixelIntensityRelationship{end}") for end in ("", "Sign"))
    require_choice(f"file {path}: PixelIntensityRelationship", str(relationship or ""), ("LIN", "LOG"))
    require_choice(f"file {path}: PixelIntensityRelationshipSign", str(sign or ""), ("1", "-1"))
    if "ModalityLUTSequence" in item:
        raise InputError(
            f"file {path}: modality LUT = of pixels {_PROCESSING}; allowed: a slope, which keeps {relationship}"
        )
    slope = float(item.get("RescaleSlope", 1))
    if not slope > 0:
        raise InputError(f"file {path}: RescaleSlope = {slope:g} of pixels {_PROCESSING}; allowed: more than 0")
    stored = pixels_of(item, path)
    values = np.asarray(apply_modality_lut(stored, item), np.float64)
    padding = padding_of(item, stored)
    if padding.any() and not padding.all():
        # As where the whole beam arrives, which is shown black.
        values[padding] = values[~padding].max() if int(sign) == 1 else values[~padding].min()
    if relationship == "LOG":
        share = (values - values.min()) / max(float(np.ptp(values)), 1e-12)
        return np.asarray(1.0 - share if int(sign) == 1 else share)
    if int(sign) == -1:
        raise InputError(
            f"file {path}: linear pixels fall with the beam, from a value without one that is not said; allowed: sign 1"
        )
    if pixel_mm is None:
        raise InputError(
            f"file {path}: ImagerPixelSpacing = none of linear pixels; allowed: one, which sizes are shown by"
        )
    if not values.max() > 0:
        raise InputError(f"file {path}: linear pixels = {values.max():g} at most; allowed: more than 0")
    signal = np.maximum(values * (_GREYS / values.max()), 1.0).astype(np.float32)
    return processed(signal, pixel_mm, look).astype(np.float64)


def _displayed(item: FileDataset, stored: NDArray[Any]) -> Array:
    """(rows, cols) 0 to 1, after modality and VOI transformations, over the range that these give."""
    bits, signed = int(item.BitsStored), int(item.PixelRepresentation) == 1
    ends = np.array([-(2 ** (bits - 1)), 2 ** (bits - 1) - 1] if signed else [0, 2**bits - 1], np.float64)
    if "ModalityLUTSequence" in item:
        ends = np.array([0, 2 ** int(item.ModalityLUTSequence[0].LUTDescriptor[2]) - 1], np.float64)
    elif "RescaleSlope" in item:
        ends = ends * float(item.RescaleSlope) + float(item.RescaleIntercept)
    values = apply_voi_lut(apply_modality_lut(stored, item), item)
    if item.get("VOILUTSequence"):
        ends = np.array([0, 2 ** int(item.VOILUTSequence[0].LUTDescriptor[2]) - 1], np.float64)
    return np.clip((values - ends.min()) / np.ptp(ends), 0.0, 1.0)


def _pixel_mm(item: FileDataset, path: Path, allowed_mm: tuple[float, float]) -> float | None:
    """Pitch at the detector, else at wherever it was calibrated."""
    pitch = item.get("ImagerPixelSpacing") or item.get("PixelSpacing")
    if not pitch:
        return None
    if np.size(pitch) != 2:
        raise InputError(f"file {path}: pixel spacing must be two numbers, got {pitch}")
    down, across = map(float, pitch)
    if abs(down - across) > _SQUARE * across:
        raise InputError(f"file {path}: pixel = {down:g} by {across:g} mm; allowed: square")
    require(f"file {path}: pixel_mm", across, *allowed_mm, "mm")
    return across
