"""Rays from the source to the pixels: their ways, their lengths, and the part of them inside a box."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from .sheets import Frame


def ways_mm(frame: Frame, rows: NDArray[np.integer], cols: NDArray[np.integer]) -> tuple[Array, float, Array]:
    """From the source to pixels, mm: x of each column, y, z of each row

    rows, cols  (n,), (m,)  numbers of rows and columns
    """
    x, z = frame.way.x + cols * frame.pixel_mm, frame.way.z - rows * frame.pixel_mm
    return np.asarray(x, np.float64), frame.way.y, np.asarray(z, np.float64)


def add_box(frame: Frame, bounds: Array, first: int, fraction: Array) -> None:
    """Add the part of each ray inside an axis-parallel box, over its length.

    bounds    (2, 3)        mm
    fraction  (rows, cols)  share of the way, added to in place; its rows begin at row `first`
    """
    x, y, z = ways_mm(frame, first + np.arange(fraction.shape[0]), np.arange(fraction.shape[1]))
    ways = x, np.array([y]), z[:, None]
    slabs = [_between(*each) for each in zip(bounds[0], bounds[1], frame.source, ways, strict=True)]
    near, far = (np.maximum(slabs[0][0], slabs[1][0]), np.minimum(slabs[0][1], slabs[1][1]))
    fraction += np.maximum(np.minimum(far, slabs[2][1]) - np.maximum(near, slabs[2][0]), 0.0)


def to_mm(fraction: Array, frame: Frame, first: int) -> Array:
    """(rows, cols)  lengths, mm, from fractions of the way from source to pixel

    fraction  (rows, cols)  share of the way; its rows begin at row `first`
    """
    return np.asarray(fraction * _lengths_mm(frame, first, *fraction.shape))


@lru_cache(maxsize=8)  # every material of a band asks
def _lengths_mm(frame: Frame, first: int, rows: int, cols: int) -> Array:
    x, y, z = ways_mm(frame, first + np.arange(rows), np.arange(cols))
    return np.asarray(np.sqrt(x * x + y * y + (z * z)[:, None]))


def _between(low: float, high: float, source: float, way: Array) -> tuple[Array, Array]:
    """Fractions of ways at which they enter and leave a slab, no less than 0 and no more than 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - source) / way, (high - source) / way
    near, far = np.maximum(np.minimum(one, other), 0.0), np.minimum(np.maximum(one, other), 1.0)
    # Parallel to the slab: its lower side counts as inside and its upper one as outside.
    near[way == 0], far[way == 0] = (0.0, 1.0) if low <= source < high else (1.0, 0.0)
    return near, far
