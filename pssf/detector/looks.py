"""Looks: signal -> grey, 0 black to 1 white, bone bright.

A processing as vendors have it keeps the order of neighbours and not that of places far apart; a film keeps both.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.blocks import block_mean, enlarge
from ..data.looks import Film, Processed
from .pyramid import join, split

Image = NDArray[np.float32]
# Quantiles are taken of every so-manieth pixel.
_EVERY = 4
# Of an open beam: the quantile of the signal that is taken for its greatest.
_GREATEST = 0.999
# Of a row or column: the share that is dim behind a leaf, where noise lets the rest through.
_LEAF = 0.99


def linear(signal: Image) -> Image:
    """(rows, cols)  log signal, large structures evened out, edges a little sharper

    signal  (rows, cols)  DN above the offset, at least 1
    """
    density = -np.log(signal)
    step = max(1, max(signal.shape) // 128)
    coarse = enlarge(ndimage.gaussian_filter(block_mean(density, step), 4.0), step, signal.shape)
    # Part of what is larger than a few centimetres is taken away, so that thigh, knee and calf share one window.
    even = density - 0.45 * coarse + 0.6 * (density - ndimage.gaussian_filter(density, 3.0))
    low, high = np.percentile(even[::4, ::4], [0.5, 99.8])
    scaled = np.clip((even - low) / max(float(high - low), 1e-6), 0, 1.12)
    return np.asarray(225.0 / 255.0 * scaled**2.2)


def processed(signal: Image, pixel_mm: float, look: Processed) -> Image:
    """(rows, cols)  as a flat panel's software shows it (Vuylsteke and Schoeters 1994)

    signal    (rows, cols)  DN above the offset, at least 1
    pixel_mm  pitch
    """
    limb, dimmest = _limb(signal, look)
    # The logarithm of what lies behind the collimator would be all that the coarse layers hold.
    density = -np.log(np.maximum(signal, dimmest))
    details, rest = split(density)
    for number, layer in enumerate(details):
        details[number] = _amplified(layer, look) * np.float32(_gain(pixel_mm * 2.0 ** (number + 1), look))
    middle = np.float32(rest.mean())
    even = join(details, middle + np.float32(look.latitude_gain) * (rest - middle))
    low, high = _quantiles(even, limb, (look.dark, look.bright))
    grey = _bent((even - low) / np.float32(max(high - low, 1e-6)), look.bend)
    grey[_behind_leaves(signal < dimmest)] = 0
    return grey


def film(signal: Image, look: Film) -> Image:
    """(rows, cols)  as a screen and film show it, on a viewing box

    signal  (rows, cols)  DN above the offset, at least 1
    """
    limb, _ = _limb(signal, look)
    (median,) = _quantiles(signal, limb, (0.5,))
    share = (look.middle - look.base) / (look.most - look.base)
    dose = signal / np.float32(median * (1 / share - 1) ** (1 / look.slope))
    return np.asarray(1 / (1 + dose ** np.float32(look.slope)), np.float32)


def _limb(signal: Image, look: Processed | Film) -> tuple[NDArray[np.bool_], float]:
    """Which of every so-manieth pixel show the limb, and the dimmest signal that is not the collimator's."""
    some = signal[::_EVERY, ::_EVERY]
    greatest = float(np.quantile(some, _GREATEST))
    limb = (some < look.open * greatest) & (some > look.shut * greatest)
    # An even field has no limb.
    return (limb if limb.any() else np.ones_like(limb)), max(1.0, look.shut * greatest)


def _behind_leaves(dim: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whole rows and columns along the edges that are dim: what is dim within the field is a thick limb."""
    behind = np.zeros_like(dim)
    for rows, dark in ((behind, dim), (behind.T, dim.T)):
        whole = dark.mean(axis=1) > _LEAF
        for edge, along in ((rows, whole), (rows[::-1], whole[::-1])):
            edge[: int(np.argmin(along)) if not along.all() else len(along)] = True
    return behind


def _quantiles(image: Image, limb: NDArray[np.bool_], shares: tuple[float, ...]) -> list[float]:
    return [float(value) for value in np.quantile(image[::_EVERY, ::_EVERY][limb], shares)]


def _amplified(detail: Image, look: Processed) -> Image:
    """Details to a power below 1: small ones gain, and those of `bound` stay as they are."""
    size = np.maximum(np.abs(detail), np.float32(look.core)) / np.float32(look.bound)
    return np.asarray(detail * size ** np.float32(look.power - 1))


def _gain(size_mm: float, look: Processed) -> float:
    """Factor of a layer of details so large."""
    fine = max(0.0, 1 - size_mm / look.edge_mm)
    coarse = 1 / (1 + (size_mm / look.latitude_mm) ** 2)
    return (1 + (look.edge_gain - 1) * fine) * (look.latitude_gain + (1 - look.latitude_gain) * coarse)


def _bent(values: Image, bend: float) -> Image:
    """Between 0 and 1 as they are, and never beyond: a bend so wide at either end."""
    sharp = np.float32(4 / bend)
    # Of log(1 + e^x) what is not max(x, 0): numpy's logaddexp takes several times as long.
    low, high = (1 + np.exp(-sharp * np.abs(values - end)) for end in (np.float32(0), np.float32(1)))
    return np.asarray(np.clip(np.clip(values, 0, 1) + np.log(low / high) / sharp, 0, 1), np.float32)
