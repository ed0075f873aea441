"""Region of interest: a square around the medial joint line."""

import numpy as np
from numpy.typing import NDArray

from ...core.checks import InputError


def cut_region(pixels: NDArray[np.generic], row: float, col: float, size: int = 512) -> NDArray[np.generic]:
    """Cut out a square region around a position, which is rounded to whole pixels.

    Parameters
    ----------
    pixels : (rows, cols) array, any unit
        Image that contains the region.
    row : float
        Row of the region centre, in pixels.
    col : float
        Column of the region centre, in pixels.
    size : int
        Edge length of the region, in pixels.

    Returns
    -------
    (size, size) array
        Region, as a view of the image array.

    Raises
    ------
    InputError
        The region extends beyond the image.
    """
    if not region_fits(pixels.shape, row, col, size):
        raise InputError(
            f"region must fit into the image of {pixels.shape} px, got {size} px centred at ({row:.0f}, {col:.0f})"
        )
    top, left = _top_left_corner(row, col, size)
    return pixels[top : top + size, left : left + size]


def region_fits(shape: tuple[int, ...], row: float, col: float, size: int) -> bool:
    """Report whether a region is inside an image; see `cut_region`.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the image.
    row : float
        Row of the region centre, in pixels.
    col : float
        Column of the region centre, in pixels.
    size : int
        Edge length of the region, in pixels.

    Returns
    -------
    bool
        True if the whole region is inside the image.
    """
    top, left = _top_left_corner(row, col, size)
    return 0 <= top <= shape[0] - size and 0 <= left <= shape[1] - size


def _top_left_corner(row: float, col: float, size: int) -> tuple[int, int]:
    """Return row and column of the first pixel of a region."""
    return round(row) - size // 2, round(col) - size // 2
