"""Grey values, contrast, sharpness and noise of an image around the joint, from which a site can be recognised."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Side of the square around the centre of the joint in which the appearance is measured, in mm at the detector.
_SQUARE_MM = 80.0
_PERCENTILES = (5, 50, 95)
# Ratio of the median absolute value to the standard deviation of a normal distribution.
_MAD_TO_SD = 0.6745
APPEARANCE = ("grey_mean", "grey_sd", "grey_p5", "grey_p50", "grey_p95", "grey_gradient", "grey_noise")


def measure_appearance(
    pixels: NDArray[np.unsignedinteger[Any]], centre_px: tuple[float, float], pixel_mm: float
) -> dict[str, float]:
    """Measure the appearance of a display image in a square around the joint.

    Parameters
    ----------
    pixels : (rows, cols) array of unsigned integers, grey values
        Display image.
    centre_px : tuple of float
        Row and column of the centre of the joint, in pixels.
    pixel_mm : float
        Pixel size on the detector, in mm.

    Returns
    -------
    dict of str to float
        Values named `APPEARANCE`, as fractions of the full grey scale: mean, standard deviation, percentiles, mean
        gradient (per mm), and standard deviation of the noise, from the median of the second differences of
        neighbouring pixels (after Immerkaer 1996).
    """
    scale = float(np.iinfo(pixels.dtype).max)
    half = round(_SQUARE_MM / 2 / pixel_mm)
    row, col = (round(place) for place in centre_px)
    part = pixels[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1].astype(np.float64) / scale
    rises = np.hypot(*np.gradient(part, pixel_mm))
    # The weights 1, -2, 1 along both axes remove planes and edges along one axis; noise is amplified by a factor of 6.
    second = np.diff(np.diff(part, 2, axis=0), 2, axis=1)
    noise = float(np.median(np.abs(second))) / _MAD_TO_SD / 6
    values = (part.mean(), part.std(), *np.percentile(part, _PERCENTILES), rises.mean(), noise)
    return {name: float(value) for name, value in zip(APPEARANCE, values, strict=True)}
