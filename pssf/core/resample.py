"""Resample smooth images: average over blocks, and interpolate linearly to full resolution."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .checks import Array

# Approximate number of image rows that are averaged at a time, to limit memory.
_BAND_ROWS = 512


class RowSliceable(Protocol):
    """Define the interface of an image that returns slices of rows, such as an array or a compressed map."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of rows and number of columns."""

    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


def downsample_by_blocks(image: RowSliceable, step: int) -> Array:
    """Average an image over square blocks.

    Parameters
    ----------
    image : (rows, cols) array or RowSliceable
        Image in any unit.
    step : int
        Edge length of a block, in px.

    Returns
    -------
    (ceil(rows / step), ceil(cols / step)) float64 array
        Mean of each block. Blocks at the lower and right border of the image may be smaller.
    """
    rows, cols = image.shape
    means = _average_whole_blocks if rows % step == 0 and cols % step == 0 else _average_partial_blocks
    band = max(1, _BAND_ROWS // step) * step
    parts = [means(image[first : min(first + band, rows)], step) for first in range(0, rows, band)]
    return np.concatenate(parts) if parts else np.empty((0, -(-cols // step)))


def downsample_by_area(image: Array, side: float) -> Array:
    """Average an image over squares whose edge length may be a fractional number of pixels.

    Parameters
    ----------
    image : (rows, cols) array
        Image in any unit.
    side : float
        Edge length of a square, in px; 1 or more. The weight of a pixel is the area of the pixel inside the square.

    Returns
    -------
    (rows // side, cols // side) float64 array
        Mean of each square. Pixels that do not fill a square at the lower and right border of the image are ignored.
    """
    down, across = (_overlap_weights(length, side) for length in image.shape)
    return np.asarray((across @ (down @ image).T).T)


def _overlap_weights(length: int, side: float) -> sparse.csr_array:
    """Compute the weight of each pixel in each mean along one axis, as a sparse (length // side, length) array."""
    count = int(length / side + 1e-9)
    first, last = (np.arange(count)[:, None] + ends for ends in (0, 1))
    pixels = np.arange(int(np.ceil(side)) + 1) + (first * side).astype(int)
    parts = np.clip(np.minimum(pixels + 1, last * side) - np.maximum(pixels, first * side), 0.0, None)
    rows, kept = np.broadcast_to(first, pixels.shape), (parts > 0) & (pixels < length)
    return sparse.csr_array((parts[kept] / side, (rows[kept], pixels[kept])), shape=(count, length))


def _average_whole_blocks(image: NDArray[np.integer | np.floating], step: int) -> Array:
    """Average an image over blocks; the numbers of rows and columns must be multiples of `step`."""
    blocks = image.reshape(image.shape[0] // step, step, image.shape[1] // step, step)
    return np.asarray(np.einsum("iajb->ij", blocks, dtype=np.float64)) / step**2


def _average_partial_blocks(image: NDArray[np.integer | np.floating], step: int) -> Array:
    """Average an image over blocks, the last of which may have fewer than `step` rows or columns."""
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
        Edge length of a block, in px.
    shape : tuple of int
        Number of rows and number of columns of the interpolated map.

    Returns
    -------
    (rows, cols) float32 array
        Interpolated map. Pixels outside the outermost block centres get the nearest value.
    """
    fine = coarse.astype(np.float32)
    for axis in (0, 1):
        place = np.clip((np.arange(shape[axis]) + 0.5) / step - 0.5, 0, coarse.shape[axis] - 1)
        low = np.minimum(place.astype(int), max(coarse.shape[axis] - 2, 0))
        share = (place - low).astype(np.float32)
        high = np.minimum(low + 1, coarse.shape[axis] - 1)
        beyond = np.take(fine, high, axis)
        fine = np.take(fine, low, axis)
        # Arrays are changed in place, because the allocation of a large array takes longer than the arithmetic.
        beyond -= fine
        beyond *= share[:, None] if axis == 0 else share
        fine += beyond
    return fine
