"""Coarse maps of smooth things: block means, and back by linear interpolation."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .checks import Array

# A large image is taken in bands of about so many rows.
_BAND_ROWS = 512


class Rows(Protocol):
    """What is read by rows: an array, or a map that is held otherwise."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, cols)"""

    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


def block_mean(image: Rows, step: int) -> Array:
    """(ceil(rows/step), ceil(cols/step))  means of blocks; those at the lower and right edge may be smaller

    image  (rows, cols)  any unit
    """
    rows, cols = image.shape
    means = _whole_blocks if rows % step == 0 and cols % step == 0 else _blocks
    band = max(1, _BAND_ROWS // step) * step
    parts = [means(image[first : min(first + band, rows)], step) for first in range(0, rows, band)]
    return np.concatenate(parts) if parts else np.empty((0, -(-cols // step)))


def area_mean(image: Array, side: float) -> Array:
    """(rows // side, cols // side)  means of squares of `side` pixels, which may share pixels; what is left over is not
    told

    image  (rows, cols)  any unit
    side   1 or more, not whole in general
    """
    down, across = (_shares(length, side) for length in image.shape)
    return np.asarray((across @ (down @ image).T).T)


def _shares(length: int, side: float) -> sparse.csr_array:
    """(length // side, length)  share of each pixel in each mean along an axis"""
    count = int(length / side + 1e-9)
    first, last = (np.arange(count)[:, None] + ends for ends in (0, 1))
    pixels = np.arange(int(np.ceil(side)) + 1) + (first * side).astype(int)
    parts = np.clip(np.minimum(pixels + 1, last * side) - np.maximum(pixels, first * side), 0.0, None)
    rows, kept = np.broadcast_to(first, pixels.shape), (parts > 0) & (pixels < length)
    return sparse.csr_array((parts[kept] / side, (rows[kept], pixels[kept])), shape=(count, length))


def _whole_blocks(image: NDArray[np.integer | np.floating], step: int) -> Array:
    blocks = image.reshape(image.shape[0] // step, step, image.shape[1] // step, step)
    return np.asarray(np.einsum("iajb->ij", blocks, dtype=np.float64)) / step**2


def _blocks(image: NDArray[np.integer | np.floating], step: int) -> Array:
    sums = np.add.reduceat(image.astype(np.float64), np.arange(0, image.shape[0], step), axis=0)
    sums = np.add.reduceat(sums, np.arange(0, image.shape[1], step), axis=1)
    sizes = [np.diff(np.append(np.arange(0, n, step), n)) for n in image.shape]
    return sums / np.outer(*sizes)


def enlarge(coarse: Array, step: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(rows, cols)  a coarse map, of any unit, by linear interpolation between the centres of its blocks"""
    fine = coarse.astype(np.float32)
    for axis in (0, 1):
        place = np.clip((np.arange(shape[axis]) + 0.5) / step - 0.5, 0, coarse.shape[axis] - 1)
        low = np.minimum(place.astype(int), max(coarse.shape[axis] - 2, 0))
        share = (place - low).astype(np.float32)
        high = np.minimum(low + 1, coarse.shape[axis] - 1)
        beyond = np.take(fine, high, axis)
        fine = np.take(fine, low, axis)
        # In place: a fresh large array costs more time than the arithmetic.
        beyond -= fine
        beyond *= share[:, None] if axis == 0 else share
        fine += beyond
    return fine
