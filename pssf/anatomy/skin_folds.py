"""Folds of skin: furrows in the limb's outline, into which skin and fat go alike, down to a share of the fat there."""

from typing import NamedTuple

import numpy as np

from ..core.checks import Array
from ..data.soft import SkinFold

# Rings that a furrow is drawn through, to half its width.
_TO_HALF = 3
# From knee to knee a fold lies so much higher or lower, and rises so much from end to end of its half turn (judgement).
_HIGHER_MM, _RISE_MM = 6.0, 5.0
# Of the seed's streams, beside those of bones and plateau.
_KEY = 8


class _Furrow(NamedTuple):
    """middle_mm and share (count,): its height and how deep it is, in shares of the fat, at each angle."""

    middle_mm: Array
    share: Array
    half_mm: float


def folded(
    skin: Array, adipose: Array, fascia: Array, table: tuple[SkinFold, ...], depth: float, scale: float, seed: int
) -> tuple[Array, Array]:
    """Rings of skin and of fat with furrows, and with as many more rings as these need.

    skin, adipose, fascia  (rings, count, 3)  at the same heights and angles, mm
    depth                  that a furrow may have, in shares of the fat beneath it, below 1
    scale                  of the bones, which heights of folds follow
    seed                   of where folds lie and which are deep, on this knee
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEY,)))
    angle = np.arange(fascia.shape[1]) * (2 * np.pi / fascia.shape[1])
    furrows = [_furrow(fold, angle, depth, scale, rng) for fold in table]
    heights_mm = np.unique(np.concatenate([fascia[:, 0, 2], *(_rings_mm(furrow) for furrow in furrows)]))
    heights_mm = heights_mm[(heights_mm >= fascia[0, 0, 2]) & (heights_mm <= fascia[-1, 0, 2])]
    outer, fat, within = (_drawn_at(heights_mm, rings_mm) for rings_mm in (skin, adipose, fascia))
    share = np.zeros(fat.shape[:2])
    for furrow in furrows:
        from_middle = (heights_mm[:, None] - furrow.middle_mm) / furrow.half_mm
        share = np.maximum(share, furrow.share * np.maximum(1.0 - from_middle**2, 0.0) ** 2)
    inwards = (within - fat) * share[..., None]
    return outer + inwards, fat + inwards


def _furrow(fold: SkinFold, angle: Array, depth: float, scale: float, rng: np.random.Generator) -> _Furrow:
    higher_mm, rise_mm = rng.uniform(-1.0, 1.0, 2) * (_HIGHER_MM, _RISE_MM)
    # -1 and 1 at its ends.
    along = ((angle - np.deg2rad(fold.towards_deg) + np.pi) % (2 * np.pi) - np.pi) / np.deg2rad(fold.half_turn_deg)
    along = along.clip(-1.0, 1.0)
    middle_mm = (fold.z + higher_mm) * scale + rise_mm * along - fold.drop_mm * along**2
    return _Furrow(middle_mm, depth * fold.share * rng.uniform() * (1.0 - along**2), fold.width_mm / 2)


def _rings_mm(furrow: _Furrow) -> Array:
    low_mm, high_mm = furrow.middle_mm.min() - furrow.half_mm, furrow.middle_mm.max() + furrow.half_mm
    return np.linspace(low_mm, high_mm, int(np.ceil((high_mm - low_mm) / furrow.half_mm * _TO_HALF)) + 1)


def _drawn_at(heights_mm: Array, rings_mm: Array) -> Array:
    """Rings at other heights, on the straight lines between those given."""
    given_mm = rings_mm[:, 0, 2]
    above = np.searchsorted(given_mm, heights_mm, side="left").clip(1, len(given_mm) - 1)
    share = (heights_mm - given_mm[above - 1]) / (given_mm[above] - given_mm[above - 1])
    return rings_mm[above - 1] * (1.0 - share)[:, None, None] + rings_mm[above] * share[:, None, None]
