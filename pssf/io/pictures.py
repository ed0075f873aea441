"""Small pictures for eyes."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .atomic import write_bytes


def side_by_side(images: Sequence[NDArray[np.uint8]], path: str | Path, gap_px: int = 8) -> Path:
    """Write 8-bit images of one height as one PNG, left to right; returns its path.

    raises  InputError for a disk that is full or cannot be written
    """
    gap = np.full((images[0].shape[0], gap_px), 255, np.uint8)
    parts = [images[0]]
    for image in images[1:]:
        parts += [gap, image]
    buffer = io.BytesIO()
    Image.fromarray(np.hstack(parts)).save(buffer, format="PNG", optimize=True)
    write_bytes(Path(path), buffer.getvalue())
    return Path(path)
