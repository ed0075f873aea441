"""Slope of the power spectrum by direction."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import Array
from .texture_scales import SCALES_MM, TextureRegion, UnmeasurableTextureError, prepare_region

# Half-width of the sector of frequencies of one direction, in degrees.
_SECTOR_DEG = 30.0
# Number of spectral coefficients below which no slope is fitted.
_MIN_COEFFICIENTS = 8


def spectral_slope(
    image: NDArray[np.generic],
    *,
    pixel_mm: float,
    mask: NDArray[np.bool_] | None = None,
    scales_mm: Sequence[float] = SCALES_MM,
) -> dict[str, float]:
    """Measure the exponent of the power spectrum of a region, in all directions and along rows and columns.

    The power is proportional to f^-b, with b = 2 H + 2 = 8 - 2 D for a fractional Brownian surface. The exponent
    follows by least squares of logarithms of all coefficients with a half period between the smallest and the largest
    scale. A plane is subtracted, and the mask is tapered to 0 at its border. Gain and offset of the grey values do
    not change b.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array, optional
        True for the pixels to measure; None: all pixels.
    scales_mm : sequence of float, optional
        Half periods, in mm, in increasing order, at least two pixels.

    Returns
    -------
    dict of str to float
        Exponent b in the directions "all", "horizontal" and "vertical". Frequencies along the rows are horizontal.

    Raises
    ------
    InputError
        The image, the mask or the scales cannot be measured (see `texture_scales.prepare_region`), or the region is too
        small for the largest scale.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(200, 200))
    >>> abs(spectral_slope(noise, pixel_mm=0.2)["all"]) < 0.3
    True
    """
    region = prepare_region(image, pixel_mm, mask, scales_mm)
    power = np.abs(np.fft.fft2(_taper(region))) ** 2
    rows, cols = np.meshgrid(*(np.fft.fftfreq(length) for length in power.shape), indexing="ij")
    frequency, angle = np.hypot(rows, cols), np.rad2deg(np.arctan2(np.abs(rows), np.abs(cols)))
    band = (frequency >= 0.5 / region.scales_px[-1]) & (frequency <= 0.5 / region.scales_px[0]) & (power > 0)
    sectors = {"all": band, "horizontal": band & (angle <= _SECTOR_DEG), "vertical": band & (angle >= 90 - _SECTOR_DEG)}
    return {name: _fit_exponent(frequency[sector], power[sector]) for name, sector in sectors.items()}


def _taper(region: TextureRegion) -> Array:
    """Subtract a plane from the values (rows, cols), and taper them to 0 at the border of the mask."""
    rows, cols = np.nonzero(region.mask)
    basis = np.stack((np.ones(len(rows)), rows, cols), axis=1)
    values = region.values[region.mask]
    depth = ndimage.distance_transform_edt(np.pad(region.mask, 1))[1:-1, 1:-1]
    tapered = np.zeros(region.mask.shape)
    tapered[region.mask] = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return np.asarray(tapered * np.sin(0.5 * np.pi * depth / depth.max()) ** 2)


def _fit_exponent(frequency: Array, power: Array) -> float:
    """Fit the exponent b of power = f^-b to spectral coefficients (n,)."""
    if len(frequency) < _MIN_COEFFICIENTS:
        raise UnmeasurableTextureError(
            f"mask must be large enough for {_MIN_COEFFICIENTS} spectral coefficients between the scales, "
            f"got {len(frequency)}"
        )
    x = np.log(frequency) - np.log(frequency).mean()
    return float(-(x @ np.log(power)) / (x @ x))
