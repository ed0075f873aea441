"""Contact sheets: simulated and real films in the standard form at one scale, for eyes."""

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

_GAP_PX, _CAPTION_PX = 3, 14
_INK = 255


def sheet(rows: Sequence[tuple[str, Sequence[NDArray[np.uint8]]]]) -> bytes:
    """A PNG with one row of films under each caption.

    rows  (caption, films (height, width) of one size each)
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
