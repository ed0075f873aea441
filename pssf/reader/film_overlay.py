"""Draw landmarks and masks of a reading over its radiograph."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ..core.checks import Array
from .knee_reading import KneeReading

# Colours of masks (femur, tibia, fibula, patella), landmarks and refused landmarks, in RGB.
_MASK_COLOURS = ((230, 120, 60), (60, 160, 230), (120, 200, 90), (200, 120, 220))
_MARK, _REFUSED = (255, 230, 0), (255, 60, 60)
# Weight of a mask's colour, 0 to 1.
_MASK_WEIGHT = 0.22
# Range of grey values that is shown, as quantiles.
_SHOWN = (0.005, 0.995)
# Radius of a landmark, as a fraction of the plateau width.
_MARK_RADIUS = 0.012


def draw_overlay(image: Array, knees: Sequence[KneeReading]) -> NDArray[np.uint8]:
    """Draw the readings of a radiograph.

    Parameters
    ----------
    image : (rows, cols) array
        Grey values of the radiograph, of any unit.
    knees : sequence of KneeReading
        Readings of the radiograph.

    Returns
    -------
    (rows, cols, 3) uint8 array
        Radiograph with tinted bones and marked landmarks; landmarks of a refused knee are red.
    """
    low, high = np.quantile(image, _SHOWN)
    grey = np.clip((image - low) / max(float(high - low), 1e-9), 0, 1) * 255
    colours = np.repeat(grey[..., None], 3, axis=2)
    for knee in knees:
        for mask, colour in zip(knee.masks.values(), _MASK_COLOURS, strict=True):
            colours[mask] += _MASK_WEIGHT * (np.array(colour) - colours[mask])
    picture = Image.fromarray(np.rint(colours).astype(np.uint8))
    pen = ImageDraw.Draw(picture)
    for knee in knees:
        radius = max(1.0, _MARK_RADIUS * knee.measures.plateau_width_px)
        for row, col in knee.landmarks_px.values():
            box = (col - radius, row - radius, col + radius, row + radius)
            pen.ellipse(box, outline=_REFUSED if knee.refusal else _MARK)
    return np.asarray(picture)
