"""Laplacian pyramid (Burt and Adelson 1983): an image as details of each size, and what is left.

Each layer is smoothed by the binomial 1 4 6 4 1, and mirrored at its edges without repeating them.
"""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
# The coarsest layer has at least so many pixels a side.
_LEAST = 4


def split(image: Image, most: int = 32) -> tuple[list[Image], Image]:
    """Details from fine to coarse, each layer half as large as the one before, and the rest.

    image  (rows, cols)  in any unit
    most   layers
    """
    details, rest = list[Image](), np.asarray(image, np.float32)
    while min(rest.shape) >= 2 * _LEAST and len(details) < most:
        coarser = _coarser(rest)
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


def _coarser(image: Image) -> Image:
    """Every second row and column of an image smoothed by the binomial, which is not told between them."""
    return _every_second(_every_second(image).T).T


def _every_second(image: Image) -> Image:
    count = (len(image) + 1) // 2
    wide = np.pad(image, ((2, 2), (0, 0)), mode="reflect")
    before, near, here, behind, after = (wide[first : first + 2 * count - 1 : 2] for first in range(5))
    return np.asarray((before + after + 4 * (near + behind) + 6 * here) / 16, np.float32)


def _larger(coarse: Image, shape: tuple[int, ...]) -> Image:
    """An image with rows and columns put between its own by the binomial."""
    return _with_between(_with_between(coarse.T, shape[1]).T, shape[0])


def _with_between(coarse: Image, rows: int) -> Image:
    # Mirrored about the last row that there will be, which is one of these or one between.
    wide = np.concatenate((coarse[1:2], coarse, coarse[-2:-1] if rows % 2 else coarse[-1:]))
    fine = np.empty_like(coarse, shape=(rows, coarse.shape[1]))
    fine[::2] = (wide[:-2] + wide[2:] + 6 * coarse) / 8
    fine[1::2] = ((wide[1:-1] + wide[2:]) / 2)[: rows // 2]
    return fine
