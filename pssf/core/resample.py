"""Resampling of smooth images: block averages, and linear interpolation back to full resolution."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .checks import Array

# Rows of an image that are averaged at a time, about, to limit memory.
_BAND_ROWS = 512


class RowSliceable(Protocol):
    """Describe an image that can be read in slices of rows: an array, or a map that is stored in another form."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""

    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


def downsample_by_blocks(image: RowSliceable, step: int) -> Array:
    """Average an image over square blocks.

    Parameters
    ----------
    image : (rows, cols) array or RowSliceable
        Image in any unit.
    step : int
        Side of a block, in px.

    Returns
    -------
    (ceil(rows / step), ceil(cols / step)) float64 array
        Mean of each block. Blocks at the lower and right edge may be smaller.
    """
    rows, cols = image.shape
    means = _average_whole_blocks if rows % step == 0 and cols % step == 0 else _average_partial_blocks
    band = max(1, _BAND_ROWS // step) * step
    parts = [means(image[first : min(first + band, rows)], step) for first in range(0, rows, band)]
    return np.concatenate(parts) if parts else np.empty((0, -(-cols // step)))


def downsample_by_area(image: Array, side: float) -> Array:
    """Average an image over squares whose side need not be a whole number of pixels.

    Parameters
    ----------
    image : (rows, cols) array
        Image in any unit.
    side : float
        Side of a square, in px; 1 or more. A pixel on the edge of a square counts in proportion to its area.

    Returns
    -------
    (rows // side, cols // side) float64 array
        Mean of each square. A remainder at the lower and right edge is left out.
    """
    down, across = (_overlap_weights(length, side) for length in image.shape)
    return np.asarray((across @ (down @ image).T).T)


def _overlap_weights(length: int, side: float) -> sparse.csr_array:
    """Compute a sparse (length // side, length) array: the weight of each pixel in each mean along an axis."""
    count = int(length / side + 1e-9)
    first, last = (np.arange(count)[:, None] + ends for ends in (0, 1))
    pixels = np.arange(int(np.ceil(side)) + 1) + (first * side).astype(int)
    parts = np.clip(np.minimum(pixels + 1, last * side) - np.maximum(pixels, first * side), 0.0, None)
    rows, kept = np.broadcast_to(first, pixels.shape), (parts > 0) & (pixels < length)
    return sparse.csr_array((parts[kept] / side, (rows[kept], pixels[kept])), shape=(count, length))


def _average_whole_blocks(image: NDArray[np.integer | np.floating], step: int) -> Array:
    """Average an image whose rows and columns are multiples of the step."""
    blocks = image.reshape(image.shape[0] // step, step, image.shape[1] // step, step)
    return np.asarray(np.einsum("iajb->ij", blocks, dtype=np.float64)) / step**2


def _average_partial_blocks(image: NDArray[np.integer | np.floating], step: int) -> Array:
    """Average an image whose last blocks may be smaller than the step."""
    sums = np.add.reduceat(image.astype(np.float64), np.arange(0, image.shape[0], step), axis=0)
    sums = np.add.reduceat(sums, np.arange(0, image.shape[1], step), axis=1)
    sizes = [np.diff(np.append(np.arange(0, n, step), n)) for n in image.shape]
    return sums / np.outer(*sizes)


def upsample_linear(coarse: Array, step: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Interpolate a coarse map linearly between the centres of its blocks.

    Parameters
    ----------
    coarse : (ceil(rows / step), ceil(cols / step)) array
        Block means in any unit, as returned by `downsample_by_blocks`.
    step : int
        Side of a block, in px.
    shape : tuple of int
        Rows and columns of the result.

    Returns
    -------
    (rows, cols) float32 array
        Interpolated map. Beyond the outermost block centres the nearest value is used.
    """
    fine = coarse.astype(np.float32)
    for axis in (0, 1):
        place = np.clip((np.arange(shape[axis]) + 0.5) / step - 0.5, 0, coarse.shape[axis] - 1)
        low = np.minimum(place.astype(int), max(coarse.shape[axis] - 2, 0))
        share = (place - low).astype(np.float32)
        high = np.minimum(low + 1, coarse.shape[axis] - 1)
        beyond = np.take(fine, high, axis)
        fine = np.take(fine, low, axis)
        # The arithmetic is in place, since allocating a large array takes longer than the arithmetic itself.
        beyond -= fine
        beyond *= share[:, None] if axis == 0 else share
        fine += beyond
    return fine
