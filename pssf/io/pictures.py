"""Small pictures for screen display: previews, heat maps, captions and marked regions."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from ..detector import render_for_display
from ..model.radiograph import Radiograph
from .atomic_write import write_bytes

# RGB colours from black through red to yellow. The lightness increases monotonically, also in a greyscale print.
_HEAT_COLOURS = ((0, 0, 4), (40, 11, 84), (101, 21, 110), (159, 42, 99), (212, 72, 66), (245, 125, 21), (250, 193, 39))

# Length of the longer side of previews and of pictures with a marked region, in pixels.
_MAX_SIDE_PX = 800


def write_image_row(images: Sequence[NDArray[np.uint8]], path: str | Path, gap_px: int = 8) -> Path:
    """Write several 8-bit images side by side to one PNG file.

    Parameters
    ----------
    images : sequence of (rows, cols) or (rows, cols, 3) uint8 arrays
        Greyscale or RGB images of equal height, from left to right.
    path : str or Path
        File to write.
    gap_px : int
        Width of the white gap between two images, in pixels.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    coloured = any(image.ndim == 3 for image in images)
    shown = [_convert_to_rgb(image) if coloured else image for image in images]
    gap = np.full((shown[0].shape[0], gap_px, *shown[0].shape[2:]), 255, np.uint8)
    parts = [shown[0]]
    for image in shown[1:]:
        parts += [gap, image]
    buffer = io.BytesIO()
    Image.fromarray(np.hstack(parts)).save(buffer, format="PNG", optimize=True)
    write_bytes(Path(path), buffer.getvalue())
    return Path(path)


def make_preview(radiograph: Radiograph) -> Image.Image:
    """Create a preview of a radiograph with display processing and at most 800 pixels along the longer side.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to display.

    Returns
    -------
    PIL.Image.Image
        Greyscale preview with 8 bits per pixel.
    """
    shown = Image.fromarray(render_for_display(radiograph, processing="processed").astype(np.uint8))
    shown.thumbnail((_MAX_SIDE_PX, _MAX_SIDE_PX), Image.Resampling.LANCZOS)
    return shown


def encode_preview_png(radiograph: Radiograph) -> bytes:
    """Encode the preview of a radiograph as PNG.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to display.

    Returns
    -------
    bytes
        Content of a PNG file with the image from `make_preview`.
    """
    buffer = io.BytesIO()
    make_preview(radiograph).save(buffer, format="PNG")
    return buffer.getvalue()


def apply_heat_map(values: ArrayLike, maximum: float) -> NDArray[np.uint8]:
    """Convert values to the colours of a heat map from black through red to yellow.

    Parameters
    ----------
    values : (rows, cols) array, any unit
        Values from 0 to `maximum`. Values outside this range are clipped.
    maximum : float
        Value that corresponds to the brightest colour, in the unit of `values`.

    Returns
    -------
    (rows, cols, 3) uint8 array
        RGB colours, whose lightness increases with the value.
    """
    places = np.linspace(0, 1, len(_HEAT_COLOURS))
    shares = np.clip(np.asarray(values, np.float64) / maximum, 0, 1)
    return np.stack([np.interp(shares, places, colour) for colour in zip(*_HEAT_COLOURS, strict=True)], axis=-1).astype(
        np.uint8
    )


def make_panel(image: NDArray[np.uint8], rows: int, cols: int, caption: str = "") -> NDArray[np.uint8]:
    """Resize an image and draw a caption in the upper left corner.

    Parameters
    ----------
    image : (rows, cols) or (rows, cols, 3) uint8 array
        Greyscale or RGB image.
    rows : int
        Height of the resized image, in pixels.
    cols : int
        Width of the resized image, in pixels.
    caption : str
        Text of the caption; empty for no caption.

    Returns
    -------
    (rows, cols, 3) uint8 array
        Resized RGB image with the caption.
    """
    sheet = Image.fromarray(_convert_to_rgb(image)).resize((cols, rows), Image.Resampling.LANCZOS)
    smaller = min(rows, cols)
    inset = smaller // 36
    font = ImageFont.load_default(smaller / 20)
    ImageDraw.Draw(sheet).text((inset, inset), caption, fill="white", font=font, stroke_width=1, stroke_fill="black")
    return np.asarray(sheet)


def draw_region(
    image: NDArray[np.uint8], centre_px: tuple[float, float], side_px: float, *, colour: str, caption: str = ""
) -> NDArray[np.uint8]:
    """Resize an image to 800 pixels along the longer side, and draw a square region with a cross at its centre.

    Parameters
    ----------
    image : (rows, cols) uint8 array
        Greyscale image.
    centre_px : (row, column) tuple of float
        Centre of the region, in pixels of `image`.
    side_px : float
        Edge length of the region, in pixels of `image`.
    colour : str
        Pillow name of the line colour, such as "red".
    caption : str
        Text of the caption; empty for no caption.

    Returns
    -------
    (rows, cols, 3) uint8 array
        RGB image with 800 pixels along the longer side.
    """
    zoom = _MAX_SIDE_PX / max(image.shape)
    rows, cols = (max(1, round(length * zoom)) for length in image.shape)
    sheet = Image.fromarray(make_panel(image, rows, cols, caption))
    row, col, half, arm = (
        (centre_px[0] + 0.5) * zoom,
        (centre_px[1] + 0.5) * zoom,
        side_px * zoom / 2,
        _MAX_SIDE_PX / 60,
    )
    pen = ImageDraw.Draw(sheet)
    pen.rectangle((col - half, row - half, col + half, row + half), outline=colour, width=2)
    pen.line((col - arm, row, col + arm, row), fill=colour, width=2)
    pen.line((col, row - arm, col, row + arm), fill=colour, width=2)
    return np.asarray(sheet)


def _convert_to_rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert a greyscale image (rows, cols) to RGB (rows, cols, 3), and return an RGB image unchanged."""
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
