"""Mean square of grey-value differences by direction and distance."""

import numpy as np
from scipy import fft, ndimage

from ..core.checks import Array
from .texture_scales import TextureRegion, UnmeasurableTextureError

# Number of pixel pairs below which the mean square at a distance is not measured.
_MIN_PAIRS = 50
# Mean square difference below which it consists of rounding errors of the transforms, relative to the mean square of
# the grey values.
_MIN_RELATIVE_SQUARE = 1e-10


def measure_variogram(region: TextureRegion, directions_deg: Array) -> Array:
    """Measure the mean square of differences between pixels of a mask at given distances and directions.

    The mean square is computed for all whole displacements by Fourier transforms (Marcotte 1996), so that each pair of
    pixels of the mask is used. The mean difference is not subtracted: in a small region, that would make smooth
    surfaces appear rough.

    Parameters
    ----------
    region : TextureRegion
        Region.
    directions_deg : (d,) array
        Directions, in degrees counter-clockwise from the rows of the image.

    Returns
    -------
    (d, n) array
        Mean square for each direction and scale of the region, in squared grey values.

    Raises
    ------
    UnmeasurableTextureError
        The mask has too few pairs of pixels at a distance, or the grey values do not vary in a direction.
    """
    reach = int(np.ceil(region.scales_px[-1])) + 3
    squares, pairs = _compute_mean_squares(region, reach)
    row, col = np.rint(_list_displacements(directions_deg, region.scales_px)).astype(int) + reach
    if (pairs[row, col] < _MIN_PAIRS).any():
        raise UnmeasurableTextureError(
            f"mask must have at least {_MIN_PAIRS} pairs of pixels at each scale, got {int(pairs[row, col].min())}"
        )
    squares[squares < _MIN_RELATIVE_SQUARE * np.square(region.values[region.mask]).mean()] = 0.0
    if (squares[row, col] == 0).any():
        raise UnmeasurableTextureError(
            f"image must vary in all directions, got differences of {squares[row, col].min():g}"
        )
    return interpolate_variogram(squares, directions_deg, region.scales_px)


def interpolate_variogram(squares: Array, directions_deg: Array, scales_px: Array) -> Array:
    """Interpolate mean squares of differences between whole displacements.

    A cubic spline interpolates the logarithm of the mean square divided by the distance. This ratio is smooth where the
    mean square is a power of the distance.

    Parameters
    ----------
    squares : (2 reach + 1, 2 reach + 1) array, squared grey
        Mean square by displacement, with displacement 0 in the middle; 0 where it is unknown.
    directions_deg : (d,) array
        Directions, in degrees counter-clockwise from the rows of the image.
    scales_px : (n,) array
        Distances, in pixels.

    Returns
    -------
    (d, n) array
        Mean square for each direction and distance.
    """
    reach = len(squares) // 2
    distance = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    known = (squares > 0) & (distance > 0)
    ratio = np.log(np.divide(squares, distance, out=np.ones_like(squares), where=known))
    # The nearest known ratio replaces an unknown one; the mean of four neighbours replaces the ratio at distance 0.
    ratio = ratio[tuple(ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True))]
    ratio[reach, reach] = ratio[[reach - 1, reach + 1, reach, reach], [reach, reach, reach - 1, reach + 1]].mean()
    places = _list_displacements(directions_deg, scales_px) + reach
    return np.asarray(np.exp(ndimage.map_coordinates(ratio, places, order=3)) * scales_px)


def _list_displacements(directions_deg: Array, scales_px: Array) -> Array:
    """List the rows and columns (2, d, n) of displacements."""
    angles = np.deg2rad(directions_deg)[:, None]
    return np.stack((-np.sin(angles) * scales_px, np.cos(angles) * scales_px))


def _compute_mean_squares(region: TextureRegion, reach: int) -> tuple[Array, Array]:
    """Compute mean squares and numbers of pairs, both (2 reach + 1, 2 reach + 1), by displacement."""
    shape = [fft.next_fast_len(max(length + reach, 2 * reach + 1), real=True) for length in region.mask.shape]
    of_mask, of_value, of_square = (
        fft.rfft2(part, shape) for part in (region.mask.astype(np.float64), region.values, region.values**2)
    )

    def correlate(first: Array, second: Array) -> Array:
        full = fft.irfft2(np.conj(first) * second, shape)
        return np.asarray(np.roll(full, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1])

    pairs = np.rint(correlate(of_mask, of_mask))
    count = np.maximum(pairs, 1.0)
    squares = correlate(of_mask, of_square) + correlate(of_square, of_mask) - 2 * correlate(of_value, of_value)
    return np.where(pairs > 0, squares / count, 0.0), pairs
