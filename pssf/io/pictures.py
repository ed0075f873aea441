"""Small pictures for eyes."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from ..detector import present
from ..model.radiograph import Radiograph
from .atomic import write_bytes

# From black over red to yellow, each lighter than the one before, so that it reads in grey as well.
_HEAT = ((0, 0, 4), (40, 11, 84), (101, 21, 110), (159, 42, 99), (212, 72, 66), (245, 125, 21), (250, 193, 39))

# Of a picture that a region is drawn on.
_LONGER_PX = 800


def side_by_side(images: Sequence[NDArray[np.uint8]], path: str | Path, gap_px: int = 8) -> Path:
    """Write 8-bit images of one height, grey (rows, cols) or coloured (rows, cols, 3), as one PNG, left to right.

    returns  its path
    raises   InputError for a disk that is full or cannot be written
    """
    coloured = any(image.ndim == 3 for image in images)
    shown = [_in_colour(image) if coloured else image for image in images]
    gap = np.full((shown[0].shape[0], gap_px, *shown[0].shape[2:]), 255, np.uint8)
    parts = [shown[0]]
    for image in shown[1:]:
        parts += [gap, image]
    buffer = io.BytesIO()
    Image.fromarray(np.hstack(parts)).save(buffer, format="PNG", optimize=True)
    write_bytes(Path(path), buffer.getvalue())
    return Path(path)


def preview(radiograph: Radiograph) -> Image.Image:
    """Give a radiograph as processed for display, as a picture for a screen: its longer side is at most 800 pixels."""
    shown = Image.fromarray(present(radiograph, look="processed").astype(np.uint8))
    shown.thumbnail((_LONGER_PX, _LONGER_PX), Image.Resampling.LANCZOS)
    return shown


def preview_png(radiograph: Radiograph) -> bytes:
    """Give the same as a PNG."""
    buffer = io.BytesIO()
    preview(radiograph).save(buffer, format="PNG")
    return buffer.getvalue()


def heat(values: ArrayLike, most: float) -> NDArray[np.uint8]:
    """(rows, cols, 3)  values (rows, cols) from 0 to most in colours from black over red to yellow"""
    places = np.linspace(0, 1, len(_HEAT))
    shares = np.clip(np.asarray(values, np.float64) / most, 0, 1)
    return np.stack([np.interp(shares, places, colour) for colour in zip(*_HEAT, strict=True)], axis=-1).astype(
        np.uint8
    )


def panel(image: NDArray[np.uint8], rows: int, cols: int, caption: str = "") -> NDArray[np.uint8]:
    """(rows, cols, 3)  an image, grey or coloured, at another size, with a caption in its upper left corner"""
    sheet = Image.fromarray(_in_colour(image)).resize((cols, rows), Image.Resampling.LANCZOS)
    smaller = min(rows, cols)
    inset = smaller // 36
    font = ImageFont.load_default(smaller / 20)
    ImageDraw.Draw(sheet).text((inset, inset), caption, fill="white", font=font, stroke_width=1, stroke_fill="black")
    return np.asarray(sheet)


def framed(
    image: NDArray[np.uint8], place: tuple[float, float], side_px: float, *, colour: str, caption: str = ""
) -> NDArray[np.uint8]:
    """(rows, cols, 3)  an image with a square and a cross at its centre, at a size for eyes, with a caption

    image    (rows, cols) grey
    place    row and column of the centre, pixels of the image; side_px is in them too
    """
    zoom = _LONGER_PX / max(image.shape)
    rows, cols = (max(1, round(length * zoom)) for length in image.shape)
    sheet = Image.fromarray(panel(image, rows, cols, caption))
    row, col, half, arm = (place[0] + 0.5) * zoom, (place[1] + 0.5) * zoom, side_px * zoom / 2, _LONGER_PX / 60
    pen = ImageDraw.Draw(sheet)
    pen.rectangle((col - half, row - half, col + half, row + half), outline=colour, width=2)
    pen.line((col - arm, row, col + arm, row), fill=colour, width=2)
    pen.line((col, row - arm, col, row + arm), fill=colour, width=2)
    return np.asarray(sheet)


def _in_colour(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
