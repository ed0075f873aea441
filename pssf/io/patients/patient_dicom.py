"""Read DICOM radiographs of any manufacturer, and process their pixels for display."""

from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import FileDataset
from pydicom.pixels import apply_modality_lut, apply_voi_lut

from ...core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
)
from ...data.imaging.dicom_codes import load_dicom_tables
from ...data.imaging.display_table import FlatPanelProcessing, load_display_processing
from ...detector.display_processing import render_processed
from ..dicom.dicom_pixels import decode_pixels, find_padding, prepare_for_display

# Knee side for each value of the DICOM attribute Laterality.
_SIDES = {"R": "right", "L": "left"}
# Largest relative difference between the height and width of a pixel that counts as square, dimensionless.
_SQUARE_TOLERANCE = 0.01
# Values of the attribute PresentationIntentType (DICOM PS3.3, C.8.11.1).
_PRESENTATION = "FOR PRESENTATION"
_PROCESSING = "FOR PROCESSING"
# Largest grey value of a 16-bit detector, in DN; linear pixels are scaled to this maximum before log conversion.
_MAX_GREY = 2.0**16 - 1


def is_own_linear_dicom(path: Path) -> bool:
    """Return whether a DICOM file is a For Processing object that this package wrote.

    Parameters
    ----------
    path : Path
        File to check. If the file is unreadable, pydicom raises an error.

    Returns
    -------
    bool
        True if this package wrote the file as a For Processing object.
    """
    item = pydicom.dcmread(path, stop_before_pixels=True)
    wanted = load_dicom_tables()
    ours = str(item.get("Manufacturer", "")) == wanted.every["Manufacturer"]
    return ours and item.get("PresentationIntentType") == wanted.processing["PresentationIntentType"]


def read_dicom_film(
    path: Path, allowed_mm: tuple[float, float], processing: FlatPanelProcessing | None
) -> dict[str, Any]:
    """Read a DICOM radiograph and process its pixels for display.

    Parameters
    ----------
    path : Path
        File to read. If the file is unreadable, pydicom raises an error.
    allowed_mm : tuple of float
        Smallest and largest accepted pixel size, in mm.
    processing : FlatPanelProcessing or None
        Display processing of linear pixels; None uses the display preset "processed".

    Returns
    -------
    dict of str to object
        Fields of `FilmImage`: pixels (rows, cols) from 0 to 1 with bone bright, pixel_mm and side. pixel_mm and side
        are None if the file does not specify them.

    Raises
    ------
    InputError
        The image has several frames, colour or non-square pixels, or a For Processing file does not
        state how its pixel values depend on the detector signal.
    """
    item = prepare_for_display(pydicom.dcmread(path), path)
    frames = int(item.get("NumberOfFrames", 1) or 1)
    if frames > 1:
        raise InputError(f"file {path}: frames must be 1, got {frames}")
    kind = str(item.get("PhotometricInterpretation", ""))
    require_choice(f"file {path}: PhotometricInterpretation", kind, ("MONOCHROME1", "MONOCHROME2"))
    intent = str(item.get("PresentationIntentType", ""))
    require_choice(f"file {path}: PresentationIntentType", intent, ("", _PRESENTATION, _PROCESSING))
    pixel_mm = _read_pixel_mm(item, path, allowed_mm)
    if intent == _PROCESSING:
        pixels = _process_linear_pixels(item, path, pixel_mm, processing or load_display_processing().processed)
    else:
        stored = decode_pixels(item, path)
        shown = _apply_luts(item, stored)
        # MONOCHROME1 and INVERSE both display the smallest value as white (PS3.3, C.8.11.3.1.2 and C.11.6.1.2).
        inverse = kind == "MONOCHROME1" or str(item.get("PresentationLUTShape", "")) == "INVERSE"
        pixels = np.where(find_padding(item, stored), 0.0, 1.0 - shown if inverse else shown)
    side = _SIDES.get(str(item.get("ImageLaterality", "") or item.get("Laterality", "")))
    return {"pixels": pixels, "pixel_mm": pixel_mm, "side": side}


def _process_linear_pixels(
    item: FileDataset, path: Path, pixel_mm: float | None, processing: FlatPanelProcessing
) -> Array:
    """Apply display processing to For Processing pixels; return (rows, cols) from 0 to 1, bone bright.

    A VOI window is ignored, because the standard forbids it in For Processing objects. The sign of the pixel intensity
    relationship determines whether bone is bright; the photometric interpretation does not (DICOM PS3.3, C.8.11.3.1.2).
    A rescale with a positive slope preserves the relationship; a modality LUT may change it.
    """
    relationship, sign = (item.get(f"PixelIntensityRelationship{end}") for end in ("", "Sign"))
    require_choice(f"file {path}: PixelIntensityRelationship", str(relationship or ""), ("LIN", "LOG"))
    require_choice(f"file {path}: PixelIntensityRelationshipSign", str(sign or ""), ("1", "-1"))
    if "ModalityLUTSequence" in item:
        raise InputError(
            f"file {path}: pixels {_PROCESSING} must have a rescale slope, got a modality LUT: its "
            f"output may not be {relationship}"
        )
    slope = float(item.get("RescaleSlope", 1))
    if not slope > 0:
        raise InputError(f"file {path}: RescaleSlope of pixels {_PROCESSING} must be greater than 0, got {slope:g}")
    stored = decode_pixels(item, path)
    values = np.asarray(apply_modality_lut(stored, item), np.float64)
    padding = find_padding(item, stored)
    if padding.any() and not padding.all():
        # Padding pixels get the value of the unattenuated beam, so that they are displayed black.
        values[padding] = values[~padding].max() if int(sign) == 1 else values[~padding].min()
    if relationship == "LOG":
        share = (values - values.min()) / max(float(np.ptp(values)), 1e-12)
        return np.asarray(1.0 - share if int(sign) == 1 else share)
    if int(sign) == -1:
        raise InputError(
            f"file {path}: PixelIntensityRelationshipSign of linear pixels must be 1, got -1: the pixel value at "
            "zero signal is unknown"
        )
    if pixel_mm is None:
        raise InputError(
            f"file {path}: linear pixels must have an ImagerPixelSpacing, got none: the display processing needs "
            "the pixel size"
        )
    if not values.max() > 0:
        raise InputError(f"file {path}: the largest linear pixel value must be greater than 0, got {values.max():g}")
    signal = np.maximum(values * (_MAX_GREY / values.max()), 1.0).astype(np.float32)
    return render_processed(signal, pixel_mm, processing).astype(np.float64)


def _apply_luts(item: FileDataset, stored: NDArray[Any]) -> Array:
    """Apply the modality and VOI transformations, scale the possible output range to 0-1, and return (rows, cols)."""
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


def _read_pixel_mm(item: FileDataset, path: Path, allowed_mm: tuple[float, float]) -> float | None:
    """Read the pixel size in mm from ImagerPixelSpacing, else from PixelSpacing; return None if neither is present."""
    pitch = item.get("ImagerPixelSpacing") or item.get("PixelSpacing")
    if not pitch:
        return None
    if np.size(pitch) != 2:
        raise InputError(f"file {path}: pixel spacing must be two numbers, got {pitch}")
    down, across = map(float, pitch)
    if abs(down - across) > _SQUARE_TOLERANCE * across:
        raise InputError(f"file {path}: pixels must be square, got {down:g} by {across:g} mm")
    require_in_range(f"file {path}: pixel_mm", across, *allowed_mm, "mm")
    return across
