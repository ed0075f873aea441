"""Laplacian pyramid (Burt and Adelson 1983): decomposition of an image into detail layers by size, and a residual.

Layers are smoothed with the binomial filter 1 4 6 4 1, and mirrored at their edges without repetition of edge pixels.
"""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
# Smallest side of the coarsest layer, in pixels.
_MIN_LAYER_PX = 4


def split_pyramid(image: Image, max_layers: int = 32) -> tuple[list[Image], Image]:
    """Split an image into detail layers, from fine to coarse, and a residual.

    Parameters
    ----------
    image : (rows, cols) float32 array, any unit
        Image to split.
    max_layers : int, default 32
        Maximum number of detail layers.

    Returns
    -------
    details : list of (rows, cols) float32 array
        Detail layers in the unit of the image. Each layer has half the rows and columns of the previous layer.
    rest : (rows, cols) float32 array
        Residual: the coarsest smoothed image, in the unit of the image.
    """
    details, rest = list[Image](), np.asarray(image, np.float32)
    while min(rest.shape) >= 2 * _MIN_LAYER_PX and len(details) < max_layers:
        coarser = _downsample(rest)
        details.append(rest - _upsample(coarser, rest.shape))
        rest = coarser
    return details, rest


def join_pyramid(details: list[Image], rest: Image) -> Image:
    """Reconstruct an image from detail layers and a residual.

    Parameters
    ----------
    details : list of (rows, cols) float32 array, any unit
        Detail layers from fine to coarse, as returned by `split_pyramid`.
    rest : (rows, cols) float32 array, any unit
        Residual, in the unit of the details.

    Returns
    -------
    (rows, cols) float32 array
        Reconstructed image, equal to the original image if the details and the residual are unmodified.
    """
    for layer in reversed(details):
        rest = _upsample(rest, layer.shape) + layer
    return rest


def _downsample(image: Image) -> Image:
    """Smooth an image with the binomial filter and keep every second row and column."""
    return _downsample_rows(_downsample_rows(image).T).T


def _downsample_rows(image: Image) -> Image:
    """Smooth the columns of an image with the binomial filter and keep every second row."""
    count = (len(image) + 1) // 2
    wide = np.pad(image, ((2, 2), (0, 0)), mode="reflect")
    before, near, here, behind, after = (wide[first : first + 2 * count - 1 : 2] for first in range(5))
    return np.asarray((before + after + 4 * (near + behind) + 6 * here) / 16, np.float32)


def _upsample(coarse: Image, shape: tuple[int, ...]) -> Image:
    """Interpolate an image to the given numbers of rows and columns with the binomial filter."""
    return _upsample_rows(_upsample_rows(coarse.T, shape[1]).T, shape[0])


def _upsample_rows(coarse: Image, rows: int) -> Image:
    """Interpolate an image to the given number of rows with the binomial filter."""
    # The margin after the last row is mirrored for an odd number of rows and repeated for an even number.
    wide = np.concatenate((coarse[1:2], coarse, coarse[-2:-1] if rows % 2 else coarse[-1:]))
    fine = np.empty_like(coarse, shape=(rows, coarse.shape[1]))
    fine[::2] = (wide[:-2] + wide[2:] + 6 * coarse) / 8
    fine[1::2] = ((wide[1:-1] + wide[2:]) / 2)[: rows // 2]
    return fine
