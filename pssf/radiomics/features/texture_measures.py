"""Texture of trabecular bone: power-spectrum and grey-value features of a patch."""

import numpy as np
from scipy import stats

from ...core.checks import Array

# Minimum Nyquist frequency at which the feature fine_over_coarse is measured, in cycles/mm.
_MIN_RESOLVED_PER_MM = 2.75


def measure_texture(patch: Array, pixel_mm: float) -> dict[str, float]:
    """Measure the texture of a square patch after subtraction of the quadratic trend.

    Parameters
    ----------
    patch : (side, side) array, DN
        Patch of linear pixels.
    pixel_mm : float
        Pixel size, in mm.

    Returns
    -------
    dict of str to float
        slope_LOW_HIGH: slope of the radially averaged power spectrum (log-log, Hann window) between two frequencies in
        cycles/mm. vertical_over_horizontal: power of vertical structures divided by power of horizontal structures
        (within 30 deg), at 0.3 to 1.5 cycles/mm. fine_over_coarse: mean power at 2 to 3 cycles/mm divided by mean power
        at 0.4 to 0.8 cycles/mm; omitted if pixels are too coarse. sd_over_mean, skewness and excess_kurtosis:
        statistics of the grey values.
    """
    side = len(patch)
    row, col = (part.ravel() for part in np.mgrid[:side, :side] / side)
    basis = np.stack((np.ones_like(row), row, col, row**2, col**2, row * col), axis=1)
    flat = patch.ravel() - basis @ np.linalg.lstsq(basis, patch.ravel(), rcond=None)[0]
    power = np.abs(np.fft.fft2(flat.reshape(side, side) * np.outer(np.hanning(side), np.hanning(side)))) ** 2
    fx, fy = np.meshgrid(*2 * [np.fft.fftfreq(side, pixel_mm)])
    radius, angle = np.hypot(fx, fy), np.rad2deg(np.arctan2(np.abs(fy), np.abs(fx)))
    band = (radius > 0.3) & (radius < 1.5)
    fine = {}
    if 0.5 / pixel_mm >= _MIN_RESOLVED_PER_MM:
        low, high = ((radius > first) & (radius < last) for first, last in ((0.4, 0.8), (2.0, 3.0)))
        fine = {"fine_over_coarse": float(power[high].mean() / power[low].mean())}
    return fine | {
        "slope_0.2_2": _fit_spectral_slope(power, radius, 0.2, 2.0),
        "slope_0.2_0.8": _fit_spectral_slope(power, radius, 0.2, 0.8),
        "slope_0.8_2": _fit_spectral_slope(power, radius, 0.8, 2.0),
        "vertical_over_horizontal": float(power[band & (angle < 30)].mean() / power[band & (angle > 60)].mean()),
        "sd_over_mean": float(flat.std() / patch.mean()),
        "skewness": float(stats.skew(flat)),
        "excess_kurtosis": float(stats.kurtosis(flat)),
    }


def _fit_spectral_slope(power: Array, radius: Array, low: float, high: float) -> float:
    """Fit the slope of the radially averaged power spectrum between two frequencies, in cycles/mm."""
    step = radius[0, 1]
    ring = np.rint(radius / step).astype(int)
    mean = np.bincount(ring.ravel(), power.ravel()) / np.bincount(ring.ravel())
    centres = np.arange(len(mean)) * step
    inside = (centres >= low) & (centres <= high)
    return float(np.polyfit(np.log(centres[inside]), np.log(mean[inside]), 1)[0])
