"""Estimate signal per mAs, response curve and saturation from flat fields."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from .estimate import Estimate, make_estimate

# Fraction of pixels with the largest value of an image from which the image is saturated.
_SATURATED_SHARE = 0.01
# Largest relative deviation from proportionality to the mAs that is attributed to the generator, not to the detector.
# The linearity of the output of a generator is specified to a few percent.
_LINEARITY = 0.02
# Side length of the central region, relative to that of the image.
_REGION = 0.5
# Largest value of a 16-bit pixel, in DN.
_MOST_DN = 65535


class SignalResponse(NamedTuple):
    """Signal of flat fields as a function of mAs.

    Attributes
    ----------
    signal_per_mas : Estimate
        Linear signal per mAs at the centre of the detector, in DN/mAs.
    response : tuple of (float, float) or None
        Linear and recorded signal, in DN; None if the signal is proportional to the mAs within 2 %.
    saturation_dn : int
        Largest pixel value, in DN.
    used : tuple of bool
        Whether each flat field is below saturation.
    mas : (flats,) float64 array
        Exposure of each flat field, in mAs.
    signal_dn : (flats,) float64 array
        Mean recorded signal without offset at the centre, in DN.
    """

    signal_per_mas: Estimate
    response: tuple[tuple[float, float], ...] | None
    saturation_dn: int
    used: tuple[bool, ...]
    mas: Array
    signal_dn: Array


def is_saturated(image: NDArray[np.uint16]) -> bool:
    """Return whether at least 1 % of the pixels of an image have its largest value.

    Parameters
    ----------
    image : (rows, cols) uint16 array, DN
        Recorded pixels.

    Returns
    -------
    bool
        True if the image is saturated.
    """
    return bool((image == image.max()).mean() >= _SATURATED_SHARE)


def measure_signal_response(
    flats: Sequence[NDArray[np.uint16]], mas: Sequence[float], offset_dn: float, open_beam: Array
) -> SignalResponse:
    """Measure the signal per mAs and the response curve.

    Parameters
    ----------
    flats : sequence of (rows, cols) uint16 array, DN
        Flat fields.
    mas : sequence of float
        mAs of each flat field.
    offset_dn : float
        Value of a pixel without exposure, in DN.
    open_beam : (rows, cols) array, dimensionless
        Signal of the open beam relative to the centre of the detector.

    Returns
    -------
    SignalResponse
        Signal per mAs with its interval, and response curve if the signal is not proportional to the mAs.

    Raises
    ------
    InputError
        If all flat fields are saturated, or the signal does not increase with the mAs.
    """
    region = tuple(slice(int(n * (1 - _REGION) / 2), int(np.ceil(n * (1 + _REGION) / 2))) for n in flats[0].shape)
    tops = [int(flat.max()) for flat in flats]
    used = tuple(not is_saturated(flat) for flat in flats)
    if not any(used):
        raise InputError(f"flat fields must be below saturation, got {len(flats)} saturated flat fields")
    values = [((flat - offset_dn) / open_beam)[region] for flat in flats]
    signal = np.array([float(value.mean()) for value in values])
    errors = np.array([float(value.std()) / np.sqrt(value.size / 64) for value in values])
    exposures, kept = np.array(mas, np.float64), np.array(used)
    _require_increase(exposures[kept], signal[kept])
    weights = (signal[kept] / exposures[kept]) / (errors[kept] / exposures[kept])
    ratios = signal[kept] / exposures[kept]
    response = None
    slope = float(np.average(ratios, weights=weights**2))
    error = float(slope / np.sqrt((weights**2).sum()))
    if np.abs(ratios / slope - 1).max() > _LINEARITY:
        slope, response = _make_response(exposures[kept], signal[kept])
        error = float(errors[kept][0] / exposures[kept][0])
    saturation = min(tops[n] for n in range(len(flats)) if not used[n]) if not all(used) else _MOST_DN
    return SignalResponse(make_estimate(slope, error), response, saturation, used, exposures, signal)


def _require_increase(mas: Array, signal: Array) -> None:
    """Raise InputError if the signal does not increase with the mAs."""
    order = np.argsort(mas, kind="stable")
    for one, other in pairwise(order):
        if mas[one] < mas[other] and signal[one] >= signal[other]:
            raise InputError(
                f"signal of the flat fields must increase with the mAs, got {signal[one]:.0f} DN at {mas[one]:g} mAs "
                f"and {signal[other]:.0f} DN at {mas[other]:g} mAs; check the order of the files"
            )
    if signal.min() <= 0:
        raise InputError(f"signal of the flat fields must be above the offset, got {signal.min():.1f} DN")


def _make_response(mas: Array, signal: Array) -> tuple[float, tuple[tuple[float, float], ...]]:
    """Make a response curve through the flat fields; return the linear signal per mAs and the curve.

    The linear signal equals the recorded signal at the lowest exposure. Beyond the highest exposure, the curve
    continues as a straight line.
    """
    levels = np.unique(mas)
    recorded = np.array([signal[mas == level].mean() for level in levels])
    slope = float(recorded[0] / levels[0])
    linear = slope * levels
    rows = [(0.0, 0.0), *zip(linear.round(4).tolist(), recorded.round(4).tolist(), strict=True)]
    (x0, y0), (x1, y1) = rows[-2], rows[-1]
    if y1 < _MOST_DN:
        rows.append((round(x1 + (_MOST_DN - y1) * (x1 - x0) / (y1 - y0), 4), float(_MOST_DN)))
    return slope, tuple(rows)
