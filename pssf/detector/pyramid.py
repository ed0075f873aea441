"""Laplacian pyramid (Burt and Adelson 1983): an image as details of each size, and what is left."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Image = NDArray[np.float32]
_BINOMIAL = np.array([1, 4, 6, 4, 1], np.float32) / 16
# The coarsest layer has at least so many pixels a side.
_LEAST = 4


def split(image: Image, most: int = 32) -> tuple[list[Image], Image]:
    """Details from fine to coarse, each layer half as large as the one before, and the rest.

    image  (rows, cols)  in any unit
    most   layers
    """
    details, rest = list[Image](), np.asarray(image, np.float32)
    while min(rest.shape) >= 2 * _LEAST and len(details) < most:
        coarser = _smooth(rest)[::2, ::2]
        details.append(rest - _larger(coarser, rest.shape))
        rest = coarser
    return details, rest


def join(details: list[Image], rest: Image) -> Image:
    """(rows, cols)  the image that `split` took apart, or another of changed details

    details  (rows, cols) each, from fine to coarse, in the image's own unit
    rest     (rows, cols)  in the same unit
    """
    for layer in reversed(details):
        rest = _larger(rest, layer.shape) + layer
    return rest


def _smooth(image: Image) -> Image:
    across = ndimage.convolve1d(image, _BINOMIAL, axis=0, mode="mirror")
    return np.asarray(ndimage.convolve1d(across, _BINOMIAL, axis=1, mode="mirror"))


def _larger(coarse: Image, shape: tuple[int, ...]) -> Image:
    apart = np.zeros(shape, np.float32)
    apart[::2, ::2] = 4 * coarse
    return _smooth(apart)
