"""How bright the tissues of a film are beside one another, in its own display values."""

import numpy as np
from scipy.ndimage import map_coordinates

from ..core.checks import Array
from ..radiomics.texture import texture
from .form import PITCH_MM, Place, joint_pixel
from .grey_features import PATCH_MM, PATCHES, patch_base, patch_of
from .outline import Outline
from .shape_features import Features, plateau_shares

_BESIDE_MM = (4.0, 9.0)  # of the tibia's medial side, where soft tissue is alone
_DOWN_MM = (16.0, 26.0)  # below the joint, for bone and soft tissue
_WITHIN_MM = (4.0, 8.0)  # inside the bones, beside the joint space
_SHAFT_MM, _SHAFT_HALF_MM, _CANAL_MM = (55.0, 65.0), 24.0, 4.0
_FINE_MM = 0.25  # a pitch that resolves 2 cycles/mm


def tone(film: Array, field: Array, outline: Outline, place: Place) -> Features:
    """Contrasts; where the film holds the shaft, also greys with soft tissue as 0 and the shaft's cortex as 1.

    film   (rows, cols) grey, a display value
    field  (rows, cols) grey, the same in the geometry of the standard form, not stretched
    """
    soft, bone = _soft(field, outline), float(patch_of(field, outline, *PATCHES["metaphysis"]).mean())
    values = {"bone_over_soft": bone / soft if soft > 0 else float("nan"), "joint_space": _joint_space(field, outline)}
    cortex, canal = _shaft(film, place)
    if cortex > soft:
        greys = {name: float(patch_of(field, outline, *spot).mean()) for name, spot in PATCHES.items()}
        greys |= {"canal": canal, "medial_plate": _plate(field, outline)}
        values |= {f"{name}_tone": (grey - soft) / (cortex - soft) for name, grey in greys.items()}
    return values


def fine_texture(film: Array, outline: Outline, place: Place, pixel_mm: float) -> Features:
    """`texture` of three regions at the film's own pitch; nothing where that does not resolve 2 cycles/mm.

    film      (rows, cols) grey, a display value
    pixel_mm  pitch of the film
    """
    if pixel_mm > _FINE_MM:
        return {}
    side = np.arange(round(PATCH_MM / place.pitch_mm)) * place.pitch_mm
    values: Features = {}
    for name, (bone, share, above_mm) in PATCHES.items():
        level, col = patch_base(outline, bone, share)
        row, middle = joint_pixel()
        below = side - side.mean() + (level - row) * PITCH_MM - above_mm
        medial = side - side.mean() + (col - middle) * PITCH_MM
        rows, cols = place.pixels_at(below, medial)
        if rows.min() < 0 or cols.min() < 0 or rows.max() > film.shape[0] - 1 or cols.max() > film.shape[1] - 1:
            continue
        patch = map_coordinates(film, np.meshgrid(rows, cols, indexing="ij"), order=1)
        if patch.mean() > 0 and np.ptp(patch) > 0:
            values |= {f"{name}_{key}": value for key, value in texture(patch, pixel_mm).items()}
    return values


def _soft(field: Array, outline: Outline) -> float:
    """Mean beside the tibia's medial side; the fibula is on the other."""
    heights = (outline.tibia_rows - np.median(outline.tibia)) * PITCH_MM
    chosen = (heights >= _DOWN_MM[0]) & (heights <= _DOWN_MM[1])
    rows, medial = outline.tibia_rows[chosen].astype(int), outline.tibia_sides[chosen, 1]
    beside = np.arange(*(round(length / PITCH_MM) for length in _BESIDE_MM))
    cols = np.minimum(medial[:, None].astype(int) + beside, field.shape[1] - 1)
    return float(field[rows[:, None], cols].mean()) if len(rows) else float("nan")


def _joint_space(field: Array, outline: Outline) -> float:
    """(bone - space) / (bone + space) of the medial compartment."""
    share = plateau_shares(outline)
    chosen = (share > 0.15) & (share < 0.38)
    cols, femur, tibia = (part[chosen].astype(int) for part in (outline.columns, outline.femur, outline.tibia))
    space = field[(femur + tibia) // 2, cols].mean()
    within = np.arange(*(round(length / PITCH_MM) for length in _WITHIN_MM))[:, None]
    above, below = np.maximum(femur - within, 0), np.minimum(tibia + within, len(field) - 1)
    bone = (field[above, cols].mean() + field[below, cols].mean()) / 2
    return float((bone - space) / (bone + space))


def _plate(field: Array, outline: Outline) -> float:
    """Brightest mean row within 4 mm of the medial plateau's contour."""
    share = plateau_shares(outline)
    chosen = (share > 0.15) & (share < 0.38)
    cols, tibia = (part[chosen].astype(int) for part in (outline.columns, outline.tibia))
    deep = np.arange(round(4.0 / PITCH_MM) + 1)[:, None]
    return float(field[np.minimum(tibia + deep, len(field) - 1), cols].mean(axis=1).max())


def _shaft(film: Array, place: Place) -> tuple[float, float]:
    """Greys of the tibial shaft's cortex and canal; NaN where the film ends before."""
    below = np.arange(*_SHAFT_MM, PITCH_MM)
    across = np.arange(-_SHAFT_HALF_MM, _SHAFT_HALF_MM, PITCH_MM)
    rows, cols = place.pixels_at(below, across)
    if rows.max() > film.shape[0] - 1 or cols.min() < 0 or cols.max() > film.shape[1] - 1:
        return float("nan"), float("nan")
    profile = map_coordinates(film, np.meshgrid(rows, cols, indexing="ij"), order=1).mean(axis=0)
    inner = np.abs(across) < _CANAL_MM
    return float(np.percentile(profile, 95)), float(profile[inner].mean())
