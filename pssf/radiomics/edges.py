"""Edges of a radiograph by direction, apart from its tone: what templates are matched by."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import Array

# Blur of the gradient, in pixels of the working pitch, and the share of the image's mean edge that counts as none.
_BLUR_PX, _FAINT = 1.0, 0.02


def edge_field(density: Array, tile_px: float) -> NDArray[np.float32]:
    """Gradient over the strength of the edges about it: 0 where there are none, at most 1.

    Any monotone curve leaves directions alone and changes strengths by little within a tile, so that a film as
    displayed compares with the logarithm of a signal.

    density  (rows, cols)     any unit, bone bright
    tile_px  standard deviation of the window in which edges are compared
    returns  (2, rows, cols)  down, right
    """
    blurred = [ndimage.gaussian_filter(density, _BLUR_PX, order=order, mode="nearest") for order in ((1, 0), (0, 1))]
    squared = blurred[0] ** 2 + blurred[1] ** 2
    down, across = (_window(length, tile_px) for length in squared.shape)
    usual = down @ squared @ across.T + _FAINT * squared.mean()
    strength = np.sqrt(squared + usual + np.finfo(np.float32).tiny)
    return np.stack(blurred / strength).astype(np.float32)


@lru_cache(maxsize=128)  # of a few lengths
def _window(length: int, sd_px: float) -> Array:
    """(length, length)  what a Gaussian filter makes of values (length,): a product takes a third of the time"""
    return np.asarray(ndimage.gaussian_filter1d(np.eye(length), sd_px, axis=0, mode="nearest"))


class Pyramid:
    """An image that is asked for at one pitch after another, and for its edges there, which are kept.

    density  (rows, cols)  of any pitch, which counts as 1
    """

    def __init__(self, density: Array) -> None:
        self.levels = [np.asarray(density, np.float64)]
        self._edges: dict[tuple[float, float], NDArray[np.float32]] = {}

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, cols) of the image."""
        return self.levels[0].shape

    def edges(self, zoom: float, tile_px: float) -> NDArray[np.float32]:
        """(2, rows, cols)  `edge_field` of the image `zoom` times as large"""
        asked = (zoom, tile_px)
        if asked not in self._edges:
            self._edges[asked] = edge_field(self.at(zoom), tile_px)
        return self._edges[asked]

    def at(self, zoom: float) -> Array:
        """(rows, cols)  the image `zoom` times as large, without aliases; pixel i lies at (i + 0.5) / zoom - 0.5"""
        level = max(0, int(np.floor(np.log2(1.0 / zoom) + 1e-9)))
        while len(self.levels) <= level and min(self.levels[-1].shape) > 3:
            self.levels.append(_pyramid_down(self.levels[-1]))
        level = min(level, len(self.levels) - 1)
        image, rest = self.levels[level], zoom * 2**level
        shape = [max(1, round(length * zoom)) for length in self.shape]
        # What halving has left between 1 and 2 source pixels a target pixel.
        soft = ndimage.gaussian_filter(image, 0.5 * np.sqrt(max(1.0 / rest**2 - 1.0, 0.0)), mode="nearest")
        down, across = ((np.arange(length) + 0.5) / rest - 0.5 for length in shape)
        return _between(_between(soft, down).T, across).T


def _between(values: Array, places: Array) -> Array:
    """(k, m)  rows between those of values (n, m), linearly; beyond the first and last as these

    places  (k,)  row numbers
    """
    within = np.clip(places, 0, len(values) - 1)
    first = np.minimum(within.astype(np.int64), max(0, len(values) - 2))
    share = (within - first)[:, None]
    last = np.minimum(first + 1, len(values) - 1)
    return np.asarray(values[first] * (1 - share) + values[last] * share)


def _pyramid_down(image: Array) -> Array:
    """(rows // 2, cols // 2)  means of 2 x 2 pixels; `block_mean` takes twice as long and adds in another order"""
    rows, cols = (length // 2 * 2 for length in image.shape)
    pairs = image[:rows:2, :cols] + image[1:rows:2, :cols]
    return np.asarray((pairs[:, ::2] + pairs[:, 1::2]) / 4.0)
