"""Skin folds: furrows of the limb outline that indent the skin and the subcutaneous fat."""

from typing import NamedTuple

import numpy as np

from ...core.checks import Array
from ...data.anatomy.soft_tissue_tables import SkinFold

# Number of rings that model half the width of a furrow.
_RINGS_PER_HALF_WIDTH = 3
# Largest vertical displacement of a fold from its template height, upwards or downwards, in mm (assumed).
_HIGHER_MM = 6.0
# Largest height difference between the centre and the end of a tilted fold, in mm (assumed).
_RISE_MM = 5.0
# Key of the random stream for skin folds. The stream uses the form seed; bones and plateau use other keys.
_SEED_STREAM = 8


class _Furrow(NamedTuple):
    """Furrow of one skin fold.

    `middle_mm` and `share`, both (count,), are the height of the furrow and its depth as a fraction of the fat
    thickness, at each angle around the limb. `half_mm` is half the furrow width.
    """

    middle_mm: Array
    share: Array
    half_mm: float


def add_skin_folds(
    skin: Array,
    adipose: Array,
    fascia: Array,
    table: tuple[SkinFold, ...],
    depth_fraction: float,
    scale: float,
    seed: int,
) -> tuple[Array, Array]:
    """Add furrows to the rings of skin and fat, and insert the additional rings that the furrows need.

    Parameters
    ----------
    skin : (rings, count, 3) float64 array, mm
        Rings of the outer skin surface, in mm.
    adipose : (rings, count, 3) float64 array, mm
        Rings of the outer fat surface at the same heights and angles, in mm.
    fascia : (rings, count, 3) float64 array, mm
        Rings of the fascia at the same heights and angles, in mm.
    table : tuple of SkinFold
        Location and size of the template skin folds.
    depth_fraction : float
        Largest depth of a furrow as a fraction of the fat thickness, below 1.
    scale : float
        Size of the bones relative to the template. The heights of the folds are multiplied by this scale.
    seed : int
        Seed for the locations and depths of the folds of the knee.

    Returns
    -------
    outer : (m, count, 3) float64 array
        Rings of the skin with furrows, in mm.
    fat : (m, count, 3) float64 array
        Rings of the fat with furrows, in mm.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SEED_STREAM,)))
    angle = np.arange(fascia.shape[1]) * (2 * np.pi / fascia.shape[1])
    furrows = [_sample_furrow(fold, angle, depth_fraction, scale, rng) for fold in table]
    heights_mm = np.unique(np.concatenate([fascia[:, 0, 2], *(_space_furrow_rings(furrow) for furrow in furrows)]))
    heights_mm = heights_mm[(heights_mm >= fascia[0, 0, 2]) & (heights_mm <= fascia[-1, 0, 2])]
    outer, fat, within = (_interpolate_rings(heights_mm, rings_mm) for rings_mm in (skin, adipose, fascia))
    share = np.zeros(fat.shape[:2])
    for furrow in furrows:
        from_middle = (heights_mm[:, None] - furrow.middle_mm) / furrow.half_mm
        share = np.maximum(share, furrow.share * np.maximum(1.0 - from_middle**2, 0.0) ** 2)
    inwards = (within - fat) * share[..., None]
    return outer + inwards, fat + inwards


def _sample_furrow(
    fold: SkinFold, angle: Array, depth_fraction: float, scale: float, rng: np.random.Generator
) -> _Furrow:
    """Sample height, tilt and depth of a skin fold; `angle` (count,) is in radians."""
    higher_mm, rise_mm = rng.uniform(-1.0, 1.0, 2) * (_HIGHER_MM, _RISE_MM)
    # Position along the fold, from -1 at one end to +1 at the other end.
    along = ((angle - np.deg2rad(fold.towards_deg) + np.pi) % (2 * np.pi) - np.pi) / np.deg2rad(fold.half_turn_deg)
    along = along.clip(-1.0, 1.0)
    middle_mm = (fold.z + higher_mm) * scale + rise_mm * along - fold.drop_mm * along**2
    return _Furrow(middle_mm, depth_fraction * fold.share * rng.uniform() * (1.0 - along**2), fold.width_mm / 2)


def _space_furrow_rings(furrow: _Furrow) -> Array:
    """Return the heights (k,) of the rings of a furrow, in mm."""
    low_mm, high_mm = furrow.middle_mm.min() - furrow.half_mm, furrow.middle_mm.max() + furrow.half_mm
    return np.linspace(low_mm, high_mm, int(np.ceil((high_mm - low_mm) / furrow.half_mm * _RINGS_PER_HALF_WIDTH)) + 1)


def _interpolate_rings(heights_mm: Array, rings_mm: Array) -> Array:
    """Interpolate rings (rings, count, 3) linearly to other heights (m,), all in mm."""
    given_mm = rings_mm[:, 0, 2]
    above = np.searchsorted(given_mm, heights_mm, side="left").clip(1, len(given_mm) - 1)
    share = (heights_mm - given_mm[above - 1]) / (given_mm[above] - given_mm[above - 1])
    return rings_mm[above - 1] * (1.0 - share)[:, None, None] + rings_mm[above] * share[:, None, None]
