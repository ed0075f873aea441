"""Make contact sheets of normalised patient and simulated radiographs at a common scale."""

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

# Distance between neighbouring radiographs, in pixels.
_GAP_PX = 3
# Height of a caption, in pixels.
_CAPTION_PX = 14
# Grey value of the caption text.
_INK = 255


def make_contact_sheet(rows: Sequence[tuple[str, Sequence[NDArray[np.uint8]]]]) -> bytes:
    """Make a PNG image with one row of radiographs below each caption.

    Parameters
    ----------
    rows : sequence of tuple
        Caption and radiographs of each row. All radiographs are (height, width) uint8 arrays of equal size.

    Returns
    -------
    bytes
        PNG image.
    """
    height, width = next(films[0].shape for _, films in rows if len(films))
    most = max(len(films) for _, films in rows)
    canvas = Image.new("L", (most * (width + _GAP_PX), len(rows) * (height + _CAPTION_PX + _GAP_PX)))
    pen, top = ImageDraw.Draw(canvas), 0
    for caption, films in rows:
        pen.text((2, top + 1), caption, fill=_INK)
        for place, film in enumerate(films):
            canvas.paste(Image.fromarray(film), (place * (width + _GAP_PX), top + _CAPTION_PX))
        top += height + _CAPTION_PX + _GAP_PX
    buffer = io.BytesIO()
    canvas.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
