"""Local binary patterns (Ojala 2002)."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import Array, InputError
from .texture_scales import UnmeasurableTextureError, prepare_region

# Number of points on each circle, and the default radius in mm.
POINTS = 8
RADIUS_MM = 0.4


def local_binary_patterns(
    image: NDArray[np.generic],
    *,
    pixel_mm: float,
    mask: NDArray[np.bool_] | None = None,
    radius_mm: float = RADIUS_MM,
) -> Array:
    """Measure the frequencies of rotation-invariant uniform local binary patterns (Ojala 2002).

    Each pixel is compared with eight points on a circle around it. A pattern is uniform if the circle consists of at
    most one arc of points at least as bright and one arc of darker points. Grey values are replaced by their ranks,
    so that an increasing tone curve has no effect.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array, optional
        True for the pixels to measure; None: all pixels. Circles that leave the mask are not measured.
    radius_mm : float, optional
        Radius of the circle, in mm, at least two pixels.

    Returns
    -------
    (10,) array
        Fraction of pixels with 0 to 8 points at least as bright in a uniform pattern, and with a pattern that is not
        uniform.

    Raises
    ------
    InputError
        The image or the mask cannot be measured (see `texture_scales.prepare_region`), no circle fits into the mask, or
        scikit-image is not installed.

    References
    ----------
    Ojala T, Pietikainen M, Maenpaa T (2002). Multiresolution gray-scale and rotation invariant texture classification
    with local binary patterns. IEEE Trans Pattern Anal Mach Intell 24:971.

    Bayramoglu N et al. (2020). Adaptive
    segmentation of knee radiographs for selecting the optimal ROI in texture analysis. Osteoarthritis Cartilage
    28:941.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(100, 100))
    >>> local_binary_patterns(noise, pixel_mm=0.2).sum().round(6)
    np.float64(1.0)
    """
    try:
        from skimage.feature import local_binary_pattern
    except ModuleNotFoundError as error:
        raise InputError(f"local binary patterns need {error.name}: pip install 'pssf[study]'") from error
    region = prepare_region(image, pixel_mm, mask, (radius_mm,), name="radius_mm", fewest=1)
    radius_px = float(region.scales_px[0])
    # The interpolation at the diagonal points reads the pixels around them.
    reach = max(np.ceil(radius_px), np.sqrt(2) * np.ceil(radius_px / np.sqrt(2)))
    side = int(np.ceil(reach))
    disc = np.hypot(*np.mgrid[-side : side + 1, -side : side + 1]) <= reach + 1e-9
    fits = ndimage.binary_erosion(region.mask, disc, border_value=0)
    if not fits.any():
        raise UnmeasurableTextureError(f"mask must contain circles with a radius of {radius_mm:g} mm, got none")
    ranks = np.zeros(region.mask.shape, int)
    ranks[region.mask] = np.unique(region.values[region.mask], return_inverse=True)[1]
    patterns = local_binary_pattern(ranks, POINTS, radius_px, "uniform")[fits].astype(int)
    return np.asarray(np.bincount(patterns, minlength=POINTS + 2) / len(patterns))
