"""DICOM films of any maker, as they are displayed."""

from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.dataset import Dataset
from pydicom.pixels import apply_modality_lut, apply_voi_lut

from ..core.checks import Array, InputError, require, require_choice
from ..data.dicom import dicom_tables

_SIDES = {"R": "right", "L": "left"}
# Rows and columns of a pixel that is called square.
_SQUARE = 0.01


def is_linear_by_pssf(path: Path) -> bool:
    """Whether a DICOM file is For Processing, by this package; whatever pydicom raises for one that it cannot read."""
    item = pydicom.dcmread(path, stop_before_pixels=True)
    wanted = dicom_tables()
    ours = str(item.get("Manufacturer", "")) == wanted.every["Manufacturer"]
    return ours and item.get("PresentationIntentType") == wanted.processing["PresentationIntentType"]


def read(path: Path, allowed_mm: tuple[float, float]) -> dict[str, Any]:
    """Pixels (rows, cols) 0 to 1 as displayed, bone bright, with pixel_mm and side where the file says so.

    allowed_mm  least and greatest pitch
    raises      InputError for several frames, colour, linear pixels, a pitch that is no square; whatever pydicom raises
    """
    item = pydicom.dcmread(path)
    frames = int(item.get("NumberOfFrames", 1) or 1)
    if frames > 1:
        raise InputError(f"file {path}: frames = {frames}; allowed: 1")
    kind = str(item.get("PhotometricInterpretation", ""))
    require_choice(f"file {path}: PhotometricInterpretation", kind, ("MONOCHROME1", "MONOCHROME2"))
    intent = str(item.get("PresentationIntentType", ""))
    require_choice(f"file {path}: PresentationIntentType", intent, ("", "FOR PRESENTATION"))
    shown = _displayed(item)
    return {
        "pixels": 1.0 - shown if kind == "MONOCHROME1" else shown,
        "pixel_mm": _pixel_mm(item, path, allowed_mm),
        "side": _SIDES.get(str(item.get("ImageLaterality", "") or item.get("Laterality", ""))),
    }


def _displayed(item: Dataset) -> Array:
    """(rows, cols) 0 to 1, after modality and VOI transformations, over the range that these give."""
    stored = item.pixel_array
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


def _pixel_mm(item: Dataset, path: Path, allowed_mm: tuple[float, float]) -> float | None:
    """Pitch at the detector, else at wherever it was calibrated."""
    pitch = item.get("ImagerPixelSpacing") or item.get("PixelSpacing")
    if not pitch:
        return None
    down, across = map(float, pitch)
    if abs(down - across) > _SQUARE * across:
        raise InputError(f"file {path}: pixel = {down:g} by {across:g} mm; allowed: square")
    require(f"file {path}: pixel_mm", across, *allowed_mm, "mm")
    return across
