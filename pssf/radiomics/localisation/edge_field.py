"""Edge fields: edges of a radiograph by direction, largely independent of its grey scale, for template matching."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...core.checks import Array

# Standard deviation of the Gaussian before the gradient, in pixels of the resampled image.
_BLUR_PX = 1.0
# Fraction of the mean squared edge of the image that is added to that of a window, so that faint edges count little.
_FAINT = 0.02


def compute_edge_field(density: Array, tile_px: float) -> NDArray[np.float32]:
    """Compute edges by direction: the gradient divided by the strength of the edges around it.

    A monotone tone curve keeps the directions and hardly changes the relative strengths within a window. A displayed
    radiograph is therefore comparable with the logarithm of a signal.

    Parameters
    ----------
    density : (rows, cols) array, any unit
        Values that increase with attenuation, bone bright.
    tile_px : float
        Standard deviation of the window in which edges are compared, in pixels.

    Returns
    -------
    (2, rows, cols) float32 array
        Components down and right, dimensionless: 0 without edges, at most 1 in magnitude.
    """
    blurred = [ndimage.gaussian_filter(density, _BLUR_PX, order=order, mode="nearest") for order in ((1, 0), (0, 1))]
    squared = blurred[0] ** 2 + blurred[1] ** 2
    down, across = (_make_gaussian_matrix(length, tile_px) for length in squared.shape)
    usual = down @ squared @ across.T + _FAINT * squared.mean()
    strength = np.sqrt(squared + usual + np.finfo(np.float32).tiny)
    return np.stack(blurred / strength).astype(np.float32)


@lru_cache(maxsize=128)  # A run uses few lengths.
def _make_gaussian_matrix(length: int, sd_px: float) -> Array:
    """Make the matrix (length, length) of a Gaussian filter of values (length,).

    The matrix product takes a third of the time of the filter.
    """
    return np.asarray(ndimage.gaussian_filter1d(np.eye(length), sd_px, axis=0, mode="nearest"))


class Pyramid:
    """An image and its edge fields at several pixel sizes, each computed once.

    Parameters
    ----------
    density : (rows, cols) array, any unit
        Image whose pixel size counts as 1.
    """

    def __init__(self, density: Array) -> None:
        self.levels = [np.asarray(density, np.float64)]
        self._edges: dict[tuple[float, float], NDArray[np.float32]] = {}

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns of the image."""
        return self.levels[0].shape

    def edges(self, zoom: float, tile_px: float) -> NDArray[np.float32]:
        """Return the edge field of the resampled image; see `compute_edge_field`.

        Parameters
        ----------
        zoom : float
            Size of the resampled image relative to the original.
        tile_px : float
            Standard deviation of the window in which edges are compared, in pixels of the resampled image.

        Returns
        -------
        (2, rows, cols) float32 array
            Components down and right, dimensionless.
        """
        asked = (zoom, tile_px)
        if asked not in self._edges:
            self._edges[asked] = compute_edge_field(self.resample_image(zoom), tile_px)
        return self._edges[asked]

    def resample_image(self, zoom: float) -> Array:
        """Resample the image without aliasing; pixel i of the result is at (i + 0.5) / zoom - 0.5 of the original.

        Parameters
        ----------
        zoom : float
            Size of the resampled image relative to the original.

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
        # After the halvings, each target pixel covers 1 to 2 source pixels.
        soft = ndimage.gaussian_filter(image, 0.5 * np.sqrt(max(1.0 / rest**2 - 1.0, 0.0)), mode="nearest")
        down, across = ((np.arange(length) + 0.5) / rest - 0.5 for length in shape)
        return _interpolate_rows(_interpolate_rows(soft, down).T, across).T


def _interpolate_rows(values: Array, positions: Array) -> Array:
    """Interpolate the rows of an array (n, m) linearly at row positions (k,); return (k, m).

    Positions outside use the first or last row.
    """
    within = np.clip(positions, 0, len(values) - 1)
    first = np.minimum(within.astype(np.int64), max(0, len(values) - 2))
    share = (within - first)[:, None]
    last = np.minimum(first + 1, len(values) - 1)
    return np.asarray(values[first] * (1 - share) + values[last] * share)


def _halve_image(image: Array) -> Array:
    """Average blocks of 2 x 2 pixels; return (rows // 2, cols // 2).

    `downsample_by_blocks` takes twice as long and sums in another order.
    """
    rows, cols = (length // 2 * 2 for length in image.shape)
    pairs = image[:rows:2, :cols] + image[1:rows:2, :cols]
    return np.asarray((pairs[:, ::2] + pairs[:, 1::2]) / 4.0)
