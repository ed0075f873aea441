"""Display processing: conversion of the signal to grey levels from 0 (black) to 1 (white).

Bone appears bright. Screen-film processing maps the signal of all pixels to grey levels with one monotonic curve.
Flat-panel processing preserves the order of signal values only among neighbouring pixels.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.resample import downsample_by_blocks, upsample_linear
from ..data.imaging.display_table import FlatPanelProcessing, ScreenFilm
from .laplacian_pyramid import join_pyramid, split_pyramid

Image = NDArray[np.float32]
# Subsampling step along rows and columns for the computation of quantiles, in pixels.
_SUBSAMPLING = 4
# Quantile of the signal that estimates the open-beam signal.
_OPEN_BEAM_QUANTILE = 0.999
# Fraction of dim pixels above which a row or column is classified as collimated. The fraction is below 1 to allow for
# noise.
_COLLIMATED_FRACTION = 0.99


def render_log(signal: Image) -> Image:
    """Render the logarithm of the signal, with attenuated large structures and slightly sharpened edges.

    Parameters
    ----------
    signal : (rows, cols) float32 array, DN
        Signal after subtraction of the detector offset, at least 1.

    Returns
    -------
    (rows, cols) float32 array
        Grey levels from 0 to 1.
    """
    density = -np.log(signal)
    step = max(1, max(signal.shape) // 128)
    coarse = upsample_linear(ndimage.gaussian_filter(downsample_by_blocks(density, step), 4.0), step, signal.shape)
    # Structures larger than a few centimetres are attenuated, so that thigh, knee and calf fit into one grey-level
    # window.
    even = density - 0.45 * coarse + 0.6 * (density - ndimage.gaussian_filter(density, 3.0))
    low, high = np.percentile(even[::4, ::4], [0.5, 99.8])
    scaled = np.clip((even - low) / max(float(high - low), 1e-6), 0, 1.12)
    return np.asarray(225.0 / 255.0 * scaled**2.2)


def render_processed(signal: Image, pixel_mm: float, processing: FlatPanelProcessing) -> Image:
    """Render a signal with multi-scale processing, as in flat-panel software (Vuylsteke and Schoeters 1994).

    Parameters
    ----------
    signal : (rows, cols) float32 array, DN
        Signal after subtraction of the detector offset, at least 1.
    pixel_mm : float
        Pixel size, in mm.
    processing : FlatPanelProcessing
        Parameters of the multi-scale processing.

    Returns
    -------
    (rows, cols) float32 array
        Grey levels from 0 to 1.
    """
    limb, dimmest = _find_limb(signal, processing)
    # The weak signal behind the collimator is clipped, because its logarithm would dominate the coarse layers.
    density = -np.log(np.maximum(signal, dimmest))
    details, rest = split_pyramid(density)
    for number, layer in enumerate(details):
        details[number] = _amplify_detail(layer, processing) * np.float32(
            _layer_gain(pixel_mm * 2.0 ** (number + 1), processing)
        )
    middle = np.float32(rest.mean())
    even = join_pyramid(details, middle + np.float32(processing.latitude_gain) * (rest - middle))
    low, high = _limb_quantiles(even, limb, (processing.dark, processing.bright))
    grey = _soft_clip((even - low) / np.float32(max(high - low, 1e-6)), processing.bend)
    grey[_find_collimated_border(signal < dimmest)] = 0
    return grey


def render_film(signal: Image, processing: ScreenFilm) -> Image:
    """Render a signal as a screen-film radiograph on a viewing box.

    Parameters
    ----------
    signal : (rows, cols) float32 array, DN
        Signal after subtraction of the detector offset, at least 1.
    processing : ScreenFilm
        Parameters of the screen-film system.

    Returns
    -------
    (rows, cols) float32 array
        Grey levels from 0 to 1.
    """
    limb, _ = _find_limb(signal, processing)
    (median,) = _limb_quantiles(signal, limb, (0.5,))
    share = (processing.middle - processing.base) / (processing.max_density - processing.base)
    dose = signal / np.float32(median * (1 / share - 1) ** (1 / processing.slope))
    return np.asarray(1 / (1 + dose ** np.float32(processing.slope)), np.float32)


def _find_limb(signal: Image, processing: FlatPanelProcessing | ScreenFilm) -> tuple[NDArray[np.bool_], float]:
    """Return the limb mask of the subsampled image, and the signal threshold for collimated pixels in DN."""
    some = signal[::_SUBSAMPLING, ::_SUBSAMPLING]
    greatest = float(np.quantile(some, _OPEN_BEAM_QUANTILE))
    limb = (some < processing.air_above_fraction * greatest) & (some > processing.collimated_below_fraction * greatest)
    # If no pixel is classified as limb, for example in a flat-field image, all pixels are used.
    return (limb if limb.any() else np.ones_like(limb)), max(1.0, processing.collimated_below_fraction * greatest)


def _find_collimated_border(dim: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the dim rows and columns at the image edges.

    Dim pixels elsewhere are excluded, because they belong to a thick limb.
    """
    behind = np.zeros_like(dim)
    for rows, dark in ((behind, dim), (behind.T, dim.T)):
        whole = dark.mean(axis=1) > _COLLIMATED_FRACTION
        for edge, along in ((rows, whole), (rows[::-1], whole[::-1])):
            edge[: int(np.argmin(along)) if not along.all() else len(along)] = True
    return behind


def _limb_quantiles(image: Image, limb: NDArray[np.bool_], fractions: tuple[float, ...]) -> list[float]:
    """Compute quantiles of an image over the pixels of the limb."""
    return [float(value) for value in np.quantile(image[::_SUBSAMPLING, ::_SUBSAMPLING][limb], fractions)]


def _amplify_detail(detail: Image, processing: FlatPanelProcessing) -> Image:
    """Raise detail amplitudes to a power.

    A power below 1 amplifies small amplitudes. The amplitude `bound` is unchanged.
    """
    size = np.maximum(np.abs(detail), np.float32(processing.core)) / np.float32(processing.bound)
    return np.asarray(detail * size ** np.float32(processing.power - 1))


def _layer_gain(detail_size_mm: float, processing: FlatPanelProcessing) -> float:
    """Compute the gain of a detail layer from its detail size in mm."""
    fine = max(0.0, 1 - detail_size_mm / processing.edge_mm)
    coarse = 1 / (1 + (detail_size_mm / processing.latitude_mm) ** 2)
    return (1 + (processing.edge_gain - 1) * fine) * (
        processing.latitude_gain + (1 - processing.latitude_gain) * coarse
    )


def _soft_clip(values: Image, bend_width: float) -> Image:
    """Clip values to the range 0 to 1, with a smooth transition of the given width at both ends."""
    sharp = np.float32(4 / bend_width)
    # The softplus function is computed explicitly, because np.logaddexp is several times slower.
    low, high = (1 + np.exp(-sharp * np.abs(values - end)) for end in (np.float32(0), np.float32(1)))
    return np.asarray(np.clip(np.clip(values, 0, 1) + np.log(low / high) / sharp, 0, 1), np.float32)
