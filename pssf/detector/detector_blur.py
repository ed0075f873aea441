"""Blur by the focal spot and by the detector, computed in the frequency domain.

Photons are absorbed at random depths in the scintillator, and the light spread depends on the depth. The transfer
function of the signal is the mean over all depths, whereas the transfer function of quantum noise is the root mean
square. High frequencies are therefore attenuated less in the noise than in the signal, and the DQE decreases with
frequency (Lubberts 1968; Cunningham 2000).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..geometry.view import SIGMA_PER_FWHM, View, magnification
from ..model.detector import Detector

Map = NDArray[np.float32]
Frequencies = NDArray[np.complex64]
# Minimum width of the mirrored margin around an image, in pixels.
_MARGIN_PX = 32


def transform_to_frequency(image: Map, workers: int = 2) -> Frequencies:
    """Transform an image to the frequency domain, after adding mirrored margins that prevent wrap-around.

    Parameters
    ----------
    image : (rows, cols) float32 array, keV
        Signal per pixel.
    workers : int, default 2
        Number of threads.

    Returns
    -------
    (padded rows, padded cols / 2 + 1) complex64 array
        Fourier coefficients of the padded image.
    """
    long, before = _padded_lengths(image.shape)
    margins = [(b, n - size - b) for b, n, size in zip(before, long, image.shape, strict=True)]
    return np.asarray(fft.rfft2(np.pad(image, margins, mode="symmetric"), workers=workers))


def transform_to_image(values: Frequencies, shape: tuple[int, ...], workers: int = 2) -> Map:
    """Transform Fourier coefficients back to an image.

    Parameters
    ----------
    values : (padded rows, padded cols / 2 + 1) complex64 array, keV
        Fourier coefficients from `transform_to_frequency`.
    shape : tuple of int
        Rows and columns of the image.
    workers : int, default 2
        Number of threads.

    Returns
    -------
    (rows, cols) float32 array
        Signal in keV per pixel.
    """
    long, before = _padded_lengths(shape)
    back = fft.irfft2(values, long, workers=workers)
    return np.asarray(back[before[0] : before[0] + shape[0], before[1] : before[1] + shape[1]])


def blur_image_by_focal_spot(image: Map, focal_spot_mm: float, view: View, workers: int = 2) -> Map:
    """Blur an image by the penumbra that a square focal spot causes for objects in the joint plane.

    The blur width on the detector is a (M - 1), where a is the focal spot width and M is the magnification of the joint
    plane.

    Parameters
    ----------
    image : (rows, cols) float32 array, keV
        Signal per pixel.
    focal_spot_mm : float
        Width of the focal spot, in mm.
    view : View
        Source and detector, which define the magnification of the joint plane.
    workers : int, default 2
        Number of threads.

    Returns
    -------
    (rows, cols) float32 array
        Blurred signal in keV per pixel.
    """
    values = transform_to_frequency(image, workers)
    apply_focal_spot_blur(values, image.shape, focal_spot_width_px(focal_spot_mm, view))
    return transform_to_image(values, image.shape, workers)


def focal_spot_width_px(focal_spot_mm: float, view: View) -> float:
    """Compute the focal-spot blur width for an edge in the joint plane.

    Parameters
    ----------
    focal_spot_mm : float
        Width of the focal spot, in mm.
    view : View
        Source and detector.

    Returns
    -------
    float
        Blur width on the detector, in pixels.
    """
    return focal_spot_mm * (magnification(view) - 1) / view.pixel_mm


def apply_focal_spot_blur(
    values: Frequencies, shape: tuple[int, ...], width_px: float, spot_shape: str = "square"
) -> None:
    """Apply the blur of a focal spot to the Fourier coefficients of an image, in place.

    Parameters
    ----------
    values : (padded rows, padded cols / 2 + 1) complex64 array, keV
        Fourier coefficients from `transform_to_frequency`; multiplied in place.
    shape : tuple of int
        Rows and columns of the image.
    width_px : float
        Blur width, in pixels.
    spot_shape : {"square", "gaussian"}, default "square"
        Shape of the focal spot. The width of a Gaussian is its full width at half maximum.
    """
    fy, fx = _frequency_axes(shape)
    if spot_shape == "gaussian":
        exponent = -2.0 * (np.pi * width_px * SIGMA_PER_FWHM) ** 2
        values *= np.exp(exponent * fy**2)[:, None]
        values *= np.exp(exponent * fx**2)
        return
    values *= np.sinc(width_px * fy)[:, None]
    values *= np.sinc(width_px * fx)


def apply_panel_blur(
    values: Frequencies, shape: tuple[int, ...], pixel_mm: float, detector: Detector, curve: str = "mtf"
) -> None:
    """Apply detector blur to the Fourier coefficients of an image, in place.

    Parameters
    ----------
    values : (padded rows, padded cols / 2 + 1) complex64 array, keV
        Fourier coefficients from `transform_to_frequency`; multiplied in place.
    shape : tuple of int
        Rows and columns of the image.
    pixel_mm : float
        Pixel size, in mm.
    detector : Detector
        Detector properties from the table.
    curve : {"mtf", "ntf"}, default "mtf"
        Transfer function to use: "mtf" for the signal, "ntf" for quantum noise.
    """
    values *= _panel_transfer(shape, pixel_mm, _select_transfer(detector, curve))


def remove_pixel_aperture(values: Frequencies, shape: tuple[int, ...], subpixels: int) -> None:
    """Divide the Fourier coefficients of an image by the transfer function of the pixel aperture, in place.

    The MTF of a detector includes the pixel aperture, which a signal that is averaged over the pixel area includes as
    well. The transfer function is that of the mean by the trapezoidal rule, see `xray.sampled_primary`.

    Parameters
    ----------
    values : (padded rows, padded cols / 2 + 1) complex64 array, keV
        Fourier coefficients from `transform_to_frequency`; divided in place.
    shape : tuple of int
        Rows and columns of the image.
    subpixels : int
        Square root of the number of rays per pixel, at least 2.
    """
    rows, cols = (np.sinc(f) / np.sinc(f / subpixels) * np.cos(np.pi * f / subpixels) for f in _frequency_axes(shape))
    values /= rows[:, None]
    values /= cols


class _Transfer(NamedTuple):
    """Transfer function: the equation with f0 in 1/mm and power, or a table, and the glare."""

    f0_per_mm: float
    power: float
    table: tuple[tuple[float, float], ...] | None
    glare_fraction: float
    glare_mm: float


@lru_cache(maxsize=2)  # The cache contains the MTF and the NTF of the current detector.
def _panel_transfer(shape: tuple[int, ...], pixel_mm: float, transfer: _Transfer) -> Map:
    """Compute the transfer function of a detector at all frequencies of a padded image."""
    if transfer.table is not None or transfer.glare_fraction > 0:
        fy, fx = (f / pixel_mm for f in _frequency_axes(shape))
        return _evaluate_transfer(transfer, np.hypot(fy[:, None], fx)).astype(np.float32)
    fy, fx = (f / np.float32(pixel_mm * transfer.f0_per_mm) for f in _frequency_axes(shape))
    # The values are computed in place, because allocating a new large array takes longer than the arithmetic.
    passed = fy[:, None] ** 2 + fx**2
    np.power(passed, np.float32(transfer.power / 2), out=passed)
    passed += 1
    return np.asarray(np.reciprocal(passed, out=passed))


def _evaluate_transfer(transfer: _Transfer, frequency_per_mm: NDArray[Any]) -> NDArray[np.float64]:
    """Evaluate a transfer function at frequencies (...) in 1/mm."""
    if transfer.table is None:
        sharp = 1 / (1 + (frequency_per_mm / transfer.f0_per_mm) ** transfer.power)
    else:
        sharp = np.interp(frequency_per_mm, *np.array(transfer.table).T)
    if transfer.glare_fraction > 0:
        wide = (1 + (2 * np.pi * transfer.glare_mm * frequency_per_mm) ** 2) ** -1.5
        sharp = sharp * (1 - transfer.glare_fraction + transfer.glare_fraction * wide)
    return np.asarray(sharp)


def compute_transfer(
    detector: Detector, frequency_per_mm: NDArray[np.float64], curve: str = "mtf"
) -> NDArray[np.float64]:
    """Compute the transfer function of a detector: 1 / (1 + (f / f0)^power), or its table, and the glare.

    Parameters
    ----------
    detector : Detector
        Detector properties from the table.
    frequency_per_mm : (...) array, 1/mm
        Spatial frequencies f, in cycles per mm.
    curve : {"mtf", "ntf"}, default "mtf"
        Transfer function to use: "mtf" for the signal, "ntf" for quantum noise.

    Returns
    -------
    (...) float64 array
        Transfer function, from 0 to 1.
    """
    return _evaluate_transfer(_select_transfer(detector, curve), frequency_per_mm)


def _select_transfer(detector: Detector, curve: str) -> _Transfer:
    """Return the transfer function for signal ("mtf") or quantum noise ("ntf")."""
    glare = (detector.glare_fraction, detector.glare_mm)
    if curve == "mtf":
        return _Transfer(detector.mtf_f0_per_mm, detector.mtf_power, detector.mtf, *glare)
    return _Transfer(detector.ntf_f0_per_mm, detector.ntf_power, detector.ntf, *glare)


def _padded_lengths(shape: tuple[int, ...]) -> tuple[list[int], list[int]]:
    """Choose padded lengths for a fast Fourier transform, and the width of the leading margin, for each axis."""
    long = [fft.next_fast_len(n + 2 * min(_MARGIN_PX, n), real=True) for n in shape]
    return long, [(length - n) // 2 for length, n in zip(long, shape, strict=True)]


def _frequency_axes(shape: tuple[int, ...]) -> tuple[Map, Map]:
    """Compute the frequencies along rows and along columns, in cycles per pixel."""
    long, _ = _padded_lengths(shape)
    return np.fft.fftfreq(long[0]).astype(np.float32), np.fft.rfftfreq(long[1]).astype(np.float32)
