"""Fractal signature by dilation and erosion with rods (Lynch 1991)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from .rod_ranges import measure_rod_ranges
from .scaling_laws import fit_local_slopes, fit_parabola, fit_slope
from .texture_scales import SCALES_MM, TextureRegion, UnmeasurableTextureError, prepare_region


@dataclass(frozen=True, kw_only=True, eq=False)
class FractalSignature:
    """Fractal dimension along the rows and columns of an image, by scale.

    A rod along the rows compares pixels of a row. It therefore measures the trabeculae that run along columns.

    Attributes
    ----------
    scales_mm : (n,) array
        Half-lengths of the rods, in mm: the given ones except the first and the last.
    horizontal, vertical : (n,) array
        Fractal dimension at each scale, with rods along the rows and along the columns.
    horizontal_dimension, vertical_dimension : float
        Fractal dimension over all scales.
    horizontal_parabola, vertical_parabola : tuple of float
        Dimension at the mean scale, its slope per mm, and its curvature per mm2 (Kraus 2009).
    """

    scales_mm: Array
    horizontal: Array
    vertical: Array
    horizontal_dimension: float
    vertical_dimension: float
    horizontal_parabola: tuple[float, float, float]
    vertical_parabola: tuple[float, float, float]


def fractal_signature(
    image: NDArray[np.generic],
    *,
    pixel_mm: float,
    mask: NDArray[np.bool_] | None = None,
    scales_mm: Sequence[float] = SCALES_MM,
) -> FractalSignature:
    """Measure the fractal signature of a region (Lynch 1991).

    For a rod of the half-length r, V(r) is the mean of dilation minus erosion over the region, and the area A(r) is
    half of its increase with r (Peleg 1984). The dimension is D = 2 - d log A / d log r, because A is proportional to
    r^(H - 1) and D = 3 - H for a fractional Brownian surface. Gain and offset of the grey values do not change D. The
    image is not smoothed or resampled.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array, optional
        True for the pixels to measure; None: all pixels.
    scales_mm : sequence of float, optional
        At least three half-lengths of rods, in mm, in increasing order, at least two pixels.

    Returns
    -------
    FractalSignature
        Dimensions.

    Raises
    ------
    InputError
        The image, the mask or the scales cannot be measured; see `texture_scales.prepare_region`.

    References
    ----------
    Lynch JA, Hawkes DJ, Buckland-Wright JC (1991). Analysis of texture in macroradiographs of osteoarthritic knees
    using the fractal signature. Phys Med Biol 36:709.

    Kraus VB et al. (2009). Trabecular morphometry by fractal
    signature analysis is a novel marker of osteoarthritis progression. Arthritis Rheum 60:3711.

    Examples
    --------
    >>> rows = np.cumsum(np.random.default_rng(1).normal(size=(300, 300)), axis=1)
    >>> fractal_signature(rows, pixel_mm=0.2).horizontal_dimension > 2.2
    True
    """
    region = prepare_region(image, pixel_mm, mask, scales_mm)
    scales = np.asarray(scales_mm, np.float64)
    areas = np.stack([_measure_areas(region, angle) for angle in (0.0, 90.0)])
    horizontal, vertical = 2.0 - fit_local_slopes(scales, areas)
    over_all = 2.0 - fit_slope(scales, areas)
    return FractalSignature(
        scales_mm=scales[1:-1],
        horizontal=horizontal,
        vertical=vertical,
        horizontal_dimension=float(over_all[0]),
        vertical_dimension=float(over_all[1]),
        horizontal_parabola=fit_parabola(scales[1:-1], horizontal),
        vertical_parabola=fit_parabola(scales[1:-1], vertical),
    )


def _measure_areas(region: TextureRegion, direction_deg: float) -> Array:
    """Measure the area A (n,) at each scale: half of the increase of the range per pixel of half-length."""
    lengths, ranges = measure_rod_ranges(region, direction_deg)
    areas = np.diff(ranges, prepend=0.0) / 2
    if (areas <= 0).any():
        raise UnmeasurableTextureError(
            f"ranges must increase with the length of rods at {direction_deg:g} degrees, got {ranges.max():g} twice"
        )
    return np.asarray(np.exp(np.interp(np.log(region.scales_px), np.log(lengths - 0.5), np.log(areas))))
