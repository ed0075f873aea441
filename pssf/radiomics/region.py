"""The region of interest: a square about the medial joint line."""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError


def cut_region(pixels: NDArray[np.generic], row: float, col: float, size: int = 512) -> NDArray[np.generic]:
    """The square of `size` pixels about (row, col), rounded to whole pixels.

    pixels   (rows, cols)  any unit
    returns  (size, size), a view of them
    raises   InputError where it leaves the image
    """
    if not region_fits(pixels.shape, row, col, size):
        raise InputError(f"region of {size} px about ({row:.0f}, {col:.0f}) leaves the image of {pixels.shape} px")
    top, left = _corner(row, col, size)
    return pixels[top : top + size, left : left + size]


def region_fits(shape: tuple[int, ...], row: float, col: float, size: int) -> bool:
    """Whether `cut_region` would stay inside an image of this shape."""
    top, left = _corner(row, col, size)
    return 0 <= top <= shape[0] - size and 0 <= left <= shape[1] - size


def _corner(row: float, col: float, size: int) -> tuple[int, int]:
    return round(row) - size // 2, round(col) - size // 2
