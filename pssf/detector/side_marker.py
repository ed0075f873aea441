"""Side marker: a lead letter on the detector cover, or a letter drawn in an image."""

import numpy as np
from numpy.typing import NDArray

from ..xray.collimator import field_half_size_mm
from ..xray.resolved_technique import Technique

# Height of the lead letter, in mm.
_HIGH_MM = 15.0
# Distance of the lead letter from both edges at the corner of the field, in mm.
_INSET_MM = 6.0
# Fraction of the signal that the 2 mm thick lead letter transmits.
_PASSES = 0.01


def compute_marker_transmission(technique: Technique) -> NDArray[np.float32]:
    """Compute the fraction of the signal that the lead marker of a protocol transmits.

    Parameters
    ----------
    technique : Technique
        Resolved protocol with the marker R (upper left corner of the field) or L (upper right corner).

    Returns
    -------
    (rows, cols) float32 array
        Transmission: 0.01 behind the letter and 1 elsewhere, with intermediate values at the edges of the letter.
    """
    protocol, view = technique.protocol, technique.view
    half_x, half_z = (half - _INSET_MM for half in field_half_size_mm(technique))
    left = protocol.marker == "R"
    col = (view.cols - 1) / 2 + (-half_x if left else half_x) / view.pixel_mm
    row = (view.rows - 1) / 2 - half_z / view.pixel_mm
    high = _HIGH_MM / view.pixel_mm
    letter = draw_letter((view.rows, view.cols), protocol.marker, high, (col, row), "la" if left else "ra")
    return np.asarray(1 - (1 - _PASSES) * letter, np.float32)


def draw_letter(
    shape: tuple[int, int], letter: str, height_px: float, position_px: tuple[float, float], anchor: str
) -> NDArray[np.float32]:
    """Draw a letter in an empty image.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the image.
    letter : str
        Letter to draw.
    height_px : float
        Height of the font, in pixels.
    position_px : tuple of float
        Column and row of the anchor, in pixels.
    anchor : str
        Anchor in the notation of Pillow: ``"la"`` for the upper left corner, ``"ra"`` for the upper right corner.

    Returns
    -------
    (rows, cols) float32 array
        Image with 1 inside the letter and 0 elsewhere.
    """
    from PIL import Image, ImageDraw, ImageFont  # Pillow is imported only if a letter is drawn.

    sheet = Image.new("L", (shape[1], shape[0]))
    font = ImageFont.load_default(max(height_px, 1.0))
    ImageDraw.Draw(sheet).text(position_px, letter, fill=255, font=font, anchor=anchor)
    return np.asarray(sheet, np.float32) / np.float32(255)
