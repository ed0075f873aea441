"""Blur as multiplication in frequency: of the focal spot, of the signal by the panel, of its quantum noise.

Quanta are absorbed at random depths, and each depth has its own spread of light: the noise passes with the root of the
mean square of the transfers, the signal with their mean. So noise keeps more of its high frequencies than the signal
does, and the DQE falls (Lubberts 1968; Cunningham 2000).
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..data.detectors import Detector
from ..geometry.view import View, magnification

Map = NDArray[np.float32]
Frequencies = NDArray[np.complex64]
_MARGIN_PX = 32


def forward(image: Map, workers: int = 2) -> Frequencies:
    """Transform of an image whose margin mirrors it, so that its far sides do not bleed into each other.

    image  (rows, cols)  keV
    """
    long, before = _padded(image.shape)
    margins = [(b, n - size - b) for b, n, size in zip(before, long, image.shape, strict=True)]
    return np.asarray(fft.rfft2(np.pad(image, margins, mode="symmetric"), workers=workers))


def backward(values: Frequencies, shape: tuple[int, ...], workers: int = 2) -> Map:
    """(rows, cols)  the image of such a shape that `forward` made frequencies of

    values  (rows, cols / 2 + 1)  of the padded image, keV
    """
    long, before = _padded(shape)
    back = fft.irfft2(values, long, workers=workers)
    return np.asarray(back[before[0] : before[0] + shape[0], before[1] : before[1] + shape[1]])


def focal_spot_blur(image: Map, focal_spot_mm: float, view: View, workers: int = 2) -> Map:
    """(rows, cols)  blurred by a square spot, magnified as in the joint plane: width a (M - 1)

    image  (rows, cols)  keV
    """
    values = forward(image, workers)
    by_focal_spot(values, image.shape, shadow_px(focal_spot_mm, view))
    return backward(values, image.shape, workers)


def shadow_px(focal_spot_mm: float, view: View) -> float:
    """Width of the spot's shadow of an edge in the joint plane, pixels."""
    return focal_spot_mm * (magnification(view) - 1) / view.pixel_mm


def by_focal_spot(values: Frequencies, shape: tuple[int, ...], width_px: float) -> None:
    """In place: blurred by a square spot whose shadow is so wide.

    values  (rows, cols / 2 + 1)  as `forward` gives them, keV
    """
    fy, fx = _axes(shape)
    values *= np.sinc(width_px * fy)[:, None]
    values *= np.sinc(width_px * fx)


def by_panel(
    values: Frequencies, shape: tuple[int, ...], pixel_mm: float, detector: Detector, part: str = "mtf"
) -> None:
    """In place: blurred by the panel, as `transfer` has it for part "mtf" or "ntf".

    values  (rows, cols / 2 + 1)  as `forward` gives them, keV
    """
    values *= _passed(shape, pixel_mm, *_law(detector, part))


@lru_cache(maxsize=2)  # the two parts of one detector
def _passed(shape: tuple[int, ...], pixel_mm: float, f0: float, power: float) -> Map:
    """(rows, cols / 2 + 1)  transfer of a panel at the frequencies of an image of such a shape"""
    fy, fx = (f / np.float32(pixel_mm * f0) for f in _axes(shape))
    # In place: a fresh large array costs more time than the arithmetic.
    passed = fy[:, None] ** 2 + fx**2
    np.power(passed, np.float32(power / 2), out=passed)
    passed += 1
    return np.asarray(np.reciprocal(passed, out=passed))


def transfer(detector: Detector, per_mm: NDArray[np.float64], part: str = "mtf") -> NDArray[np.float64]:
    """(...)  1 / (1 + (f / f0)^power) at frequencies (cycles/mm): part "mtf" for the signal, "ntf" for quantum noise

    per_mm  (...)  cycles/mm
    """
    f0, power = _law(detector, part)
    return np.asarray(1 / (1 + (per_mm / f0) ** power))


def _law(detector: Detector, part: str) -> tuple[float, float]:
    """f0 (1/mm) and power of the transfer of signal ("mtf") or quantum noise ("ntf")."""
    if part == "mtf":
        return detector.mtf_f0_per_mm, detector.mtf_power
    return detector.ntf_f0_per_mm, detector.ntf_power


def _padded(shape: tuple[int, ...]) -> tuple[list[int], list[int]]:
    """Fast lengths with a margin on both sides, and the margin before the image."""
    long = [fft.next_fast_len(n + 2 * min(_MARGIN_PX, n), real=True) for n in shape]
    return long, [(length - n) // 2 for length, n in zip(long, shape, strict=True)]


def _axes(shape: tuple[int, ...]) -> tuple[Map, Map]:
    """Frequencies down and across, cycles a pixel."""
    long, _ = _padded(shape)
    return np.fft.fftfreq(long[0]).astype(np.float32), np.fft.rfftfreq(long[1]).astype(np.float32)
