"""A letter: drawn on a view for eyes, or of lead on the detector's cover."""

import numpy as np
from numpy.typing import NDArray

from ..xray.collimator import field_half_mm
from ..xray.technique import Technique

# Height of the letter and its distance from the field's corner; what two millimetres of lead let through.
_HIGH_MM, _INSET_MM, _PASSES = 15.0, 6.0, 0.01


def lead_letter(technique: Technique) -> NDArray[np.float32]:
    """(rows, cols)  share of the signal that passes the protocol's marker, in its upper corner of the field"""
    protocol, view = technique.protocol, technique.view
    half_x, half_z = (half - _INSET_MM for half in field_half_mm(technique))
    left = protocol.marker == "R"
    col = (view.cols - 1) / 2 + (-half_x if left else half_x) / view.pixel_mm
    row = (view.rows - 1) / 2 - half_z / view.pixel_mm
    high = _HIGH_MM / view.pixel_mm
    letter = drawn_letter((view.rows, view.cols), protocol.marker, high, (col, row), "la" if left else "ra")
    return np.asarray(1 - (1 - _PASSES) * letter, np.float32)


def drawn_letter(
    shape: tuple[int, int], letter: str, high_px: float, place: tuple[float, float], anchor: str
) -> NDArray[np.float32]:
    """(rows, cols)  1 where a letter is, 0 elsewhere

    place   (column, row) of its anchor
    anchor  as Pillow has it: "la" the upper left corner, "ra" the upper right one
    """
    from PIL import Image, ImageDraw, ImageFont  # only where a letter is drawn

    sheet = Image.new("L", (shape[1], shape[0]))
    font = ImageFont.load_default(max(high_px, 1.0))
    ImageDraw.Draw(sheet).text(place, letter, fill=255, font=font, anchor=anchor)
    return np.asarray(sheet, np.float32) / np.float32(255)
