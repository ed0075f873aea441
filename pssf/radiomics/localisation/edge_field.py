"""Edge fields for template matching: normalised gradients of a radiograph, largely independent of its grey scale."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...core.checks import Array

# Standard deviation of the Gaussian derivative filter, in pixels of the resampled image.
_BLUR_PX = 1.0
# Fraction of the mean squared gradient of the image that is added to the squared gradient in a window, so that faint
# edges are suppressed.
_FAINT = 0.02


def compute_edge_field(density: Array, tile_px: float) -> NDArray[np.float32]:
    """Compute the edge field of an image: the gradient, divided by the gradient strength in a window around each pixel.

    An increasing tone curve does not change gradient directions, and hardly changes relative strengths in a window. The
    edge field of a displayed radiograph is therefore comparable with that of a log signal.

    Parameters
    ----------
    density : (rows, cols) array, any unit
        Image values that increase with attenuation (bone bright).
    tile_px : float
        Standard deviation of the Gaussian window for normalisation, in pixels.

    Returns
    -------
    (2, rows, cols) float32 array
        Downward and rightward component of the edge field, dimensionless; magnitude 0 to 1.
    """
    blurred = [ndimage.gaussian_filter(density, _BLUR_PX, order=order, mode="nearest") for order in ((1, 0), (0, 1))]
    squared = blurred[0] ** 2 + blurred[1] ** 2
    down, across = (_make_gaussian_matrix(length, tile_px) for length in squared.shape)
    usual = down @ squared @ across.T + _FAINT * squared.mean()
    strength = np.sqrt(squared + usual + np.finfo(np.float32).tiny)
    return np.stack(blurred / strength).astype(np.float32)


@lru_cache(maxsize=128)  # One run uses only a few different image lengths.
def _make_gaussian_matrix(length: int, sd_px: float) -> Array:
    """Make the matrix (length, length) of a 1D Gaussian filter.

    Filtering by matrix product takes a third of the time of `gaussian_filter1d`.
    """
    return np.asarray(ndimage.gaussian_filter1d(np.eye(length), sd_px, axis=0, mode="nearest"))


class Pyramid:
    """Image pyramid with edge fields at several pixel sizes, each computed once.

    Parameters
    ----------
    density : (rows, cols) array, any unit
        Original image.
    """

    def __init__(self, density: Array) -> None:
        self.levels = [np.asarray(density, np.float64)]
        self._edges: dict[tuple[float, float], NDArray[np.float32]] = {}

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns of the original image."""
        return self.levels[0].shape

    def edges(self, zoom: float, tile_px: float) -> NDArray[np.float32]:
        """Return the edge field of the resampled image; see the function `compute_edge_field`.

        Parameters
        ----------
        zoom : float
            Size of the resampled image divided by the size of the original image.
        tile_px : float
            Standard deviation of the Gaussian window for normalisation, in pixels of the resampled image.

        Returns
        -------
        (2, rows, cols) float32 array
            Downward and rightward component of the edge field, dimensionless.
        """
        asked = (zoom, tile_px)
        if asked not in self._edges:
            self._edges[asked] = compute_edge_field(self.resample_image(zoom), tile_px)
        return self._edges[asked]

    def resample_image(self, zoom: float) -> Array:
        """Resample the image without aliasing; new pixel i is at original position (i + 0.5) / zoom - 0.5.

        Parameters
        ----------
        zoom : float
            Size of the resampled image divided by the size of the original image.

        Returns
        -------
        (rows, cols) array
            Resampled image, in the unit of the original.
        """
        level = max(0, int(np.floor(np.log2(1.0 / zoom) + 1e-9)))
        while len(self.levels) <= level and min(self.levels[-1].shape) > 3:
            self.levels.append(_halve_image(self.levels[-1]))
        level = min(level, len(self.levels) - 1)
        image, rest = self.levels[level], zoom * 2**level
        shape = [max(1, round(length * zoom)) for length in self.shape]
        # The blur prevents aliasing: each resampled pixel covers 1 to 2 pixels of the selected pyramid level per axis.
        soft = ndimage.gaussian_filter(image, 0.5 * np.sqrt(max(1.0 / rest**2 - 1.0, 0.0)), mode="nearest")
        down, across = ((np.arange(length) + 0.5) / rest - 0.5 for length in shape)
        return _interpolate_rows(_interpolate_rows(soft, down).T, across).T


def _interpolate_rows(values: Array, positions: Array) -> Array:
    """Interpolate the rows of an array (n, m) linearly at row positions (k,); return an array (k, m).

    Positions beyond the first or last row return the first or last row.
    """
    within = np.clip(positions, 0, len(values) - 1)
    first = np.minimum(within.astype(np.int64), max(0, len(values) - 2))
    share = (within - first)[:, None]
    last = np.minimum(first + 1, len(values) - 1)
    return np.asarray(values[first] * (1 - share) + values[last] * share)


def _halve_image(image: Array) -> Array:
    """Average blocks of 2 x 2 pixels; return (rows // 2, cols // 2).

    `downsample_by_blocks` is not used, because it is half as fast and rounds differently.
    """
    rows, cols = (length // 2 * 2 for length in image.shape)
    pairs = image[:rows:2, :cols] + image[1:rows:2, :cols]
    return np.asarray((pairs[:, ::2] + pairs[:, 1::2]) / 4.0)
