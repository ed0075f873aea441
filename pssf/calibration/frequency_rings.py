"""Average noise power over rings of equal spatial frequency."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array

# Reduction of the number of independent frequencies by the Hann window in two dimensions, (35 / 18)^2.
WINDOW_CORRELATION = (35.0 / 18.0) ** 2


class Rings(NamedTuple):
    """Rings of equal spatial frequency of square regions.

    Attributes
    ----------
    frequency_per_mm : (rings,) float64 array
        Mean spatial frequency of each ring, in cycles per mm.
    members : (rings,) int array
        Number of frequencies of each ring.
    number : (side, side) int array
        Ring of each frequency.
    used : (side, side) bool array
        Whether a frequency belongs to a ring; those on the axes and beyond the Nyquist frequency do not.
    radius_per_mm : (side, side) float64 array
        Magnitude of each frequency, in cycles per mm.
    """

    frequency_per_mm: Array
    members: NDArray[np.int64]
    number: NDArray[np.int64]
    used: NDArray[np.bool_]
    radius_per_mm: Array

    def average(self, power: Array) -> Array:
        """Average the power over each ring.

        Parameters
        ----------
        power : (side, side) array, any unit
            Power of each frequency.

        Returns
        -------
        (rings,) float64 array
            Mean power of each ring, in the same unit.
        """
        return np.asarray(np.bincount(self.number[self.used], power[self.used]) / np.maximum(self.members, 1))

    def relative_error(self, regions: int) -> Array:
        """Compute the relative standard error of the mean power of each ring.

        Parameters
        ----------
        regions : int
            Number of independent regions.

        Returns
        -------
        (rings,) float64 array
            Relative standard error. A frequency and its negative have the same power, so half of the values are
            independent.
        """
        return np.asarray(np.sqrt(2 * WINDOW_CORRELATION / (np.maximum(self.members, 1) * regions)))


def make_rings(side_px: int, pixel_mm: float) -> Rings:
    """Make the rings of square regions.

    Parameters
    ----------
    side_px : int
        Side length of a region, in pixels.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    Rings
        Rings of equal width; ring 0 contains no frequency.
    """
    f = np.fft.fftfreq(side_px, pixel_mm)
    radius = np.hypot(*np.meshgrid(f, f))
    used = (np.arange(side_px)[:, None] > 0) & (np.arange(side_px) > 0) & (radius < 0.5 / pixel_mm)
    number = np.rint(radius * side_px * pixel_mm).astype(np.int64)
    count = np.bincount(number[used])
    return Rings(np.bincount(number[used], radius[used]) / np.maximum(count, 1), count, number, used, radius)


def split_regions(image: Array, side_px: int) -> Array:
    """Split an image into square regions.

    Parameters
    ----------
    image : (rows, cols) array, any unit
        Image.
    side_px : int
        Side length of a region, in pixels.

    Returns
    -------
    (regions, side_px, side_px) array
        Regions, without the last rows and columns that do not fill one.
    """
    rows, cols = (side // side_px for side in image.shape)
    cut = image[: rows * side_px, : cols * side_px].reshape(rows, side_px, cols, side_px)
    return cut.swapaxes(1, 2).reshape(-1, side_px, side_px)


def transform_regions(regions: Array, degree: int) -> Array:
    """Compute the Fourier transforms of regions without their trend.

    Parameters
    ----------
    regions : (regions, side, side) array, any unit
        Regions of an image.
    degree : int
        Degree of the polynomial of row and column that is subtracted from each region.

    Returns
    -------
    (regions, side, side) complex128 array
        Transforms under a Hann window. The mean squared magnitude of white noise is its variance.
    """
    side = regions.shape[1]
    window = np.outer(np.hanning(side), np.hanning(side))
    scale = 1.0 / np.sqrt((window**2).sum())
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    powers = [(i, j) for total in range(degree + 1) for i, j in ((total - k, k) for k in range(total + 1))]
    basis, _ = np.linalg.qr(np.stack([(x**i * y**j).ravel() for i, j in powers], axis=1))
    flat = regions.reshape(len(regions), -1)
    residual = (flat - (flat @ basis) @ basis.T).reshape(regions.shape)
    return np.asarray(np.fft.fft2(residual * window) * scale)
