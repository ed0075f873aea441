"""Measure relative grey values of tissues on a radiograph whose contrast has not been stretched."""

import numpy as np
from scipy.ndimage import map_coordinates

from ...core.checks import Array
from ...radiomics.features.texture_measures import measure_texture
from .film_normalisation import PITCH_MM, JointPosition, joint_centre_px
from .film_outline import Outline
from .grey_features import (
    PATCH_MM,
    PATCHES,
    cut_patch,
    locate_patch_base,
)
from .outline_features import Features, plateau_fractions

# Soft-tissue region: range of distances from the medial contour of the tibia, in mm.
_SOFT_TISSUE_MM = (4.0, 9.0)
# Soft-tissue region: range of distances below the joint, in mm.
_BELOW_JOINT_MM = (16.0, 26.0)
# Bone regions above and below the joint space: depth range from the bone contour, in mm.
_INSIDE_BONE_MM = (4.0, 8.0)
# Shaft region: range of distances below the joint, in mm.
_SHAFT_MM = (55.0, 65.0)
# Half width of the shaft region, in mm.
_SHAFT_HALF_MM = 24.0
# Half width of the medullary canal, in mm.
_CANAL_MM = 4.0
# Largest pixel pitch that resolves 2 cycles/mm, in mm (Nyquist).
_MAX_FINE_PITCH_MM = 0.25


def measure_tone(film: Array, field: Array, outline: Outline, place: JointPosition) -> Features:
    """Measure tissue contrasts and, if the radiograph shows the shaft, relative grey values.

    Relative grey values are 0 for soft tissue and 1 for the cortex of the shaft.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Radiograph in display values.
    field : (rows, cols) array, grey
        Radiograph in normalised geometry, without contrast stretch.
    outline : Outline
        Bone contours of `field`.
    place : JointPosition
        Position of the joint centre on `film`.

    Returns
    -------
    dict of str to float
        Features keyed by name.
    """
    soft, bone = _soft_tissue_grey(field, outline), float(cut_patch(field, outline, *PATCHES["metaphysis"]).mean())
    values = {
        "bone_to_soft_tissue_ratio": bone / soft if soft > 0 else float("nan"),
        "joint_space": _joint_space_contrast(field, outline),
    }
    cortex, canal = _shaft_greys(film, place)
    if cortex > soft:
        greys = {name: float(cut_patch(field, outline, *spot).mean()) for name, spot in PATCHES.items()}
        greys |= {"canal": canal, "medial_subchondral_plate": _plate_grey(field, outline)}
        values |= {f"{name}_tone": (grey - soft) / (cortex - soft) for name, grey in greys.items()}
    return values


def measure_fine_texture(film: Array, outline: Outline, place: JointPosition, pixel_mm: float) -> Features:
    """Measure the texture of three bone regions at the original pixel pitch.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Radiograph in display values.
    outline : Outline
        Bone contours of the normalised radiograph.
    place : JointPosition
        Position of the joint centre on `film`.
    pixel_mm : float
        Pixel pitch of the radiograph, in mm.

    Returns
    -------
    dict of str to float
        Features keyed by name; empty if the pixel pitch does not resolve 2 cycles/mm.
    """
    if pixel_mm > _MAX_FINE_PITCH_MM:
        return {}
    side = np.arange(round(PATCH_MM / place.pitch_mm)) * place.pitch_mm
    values: Features = {}
    for name, (bone, share, above_mm) in PATCHES.items():
        level, col = locate_patch_base(outline, bone, share)
        row, middle = joint_centre_px()
        below = side - side.mean() + (level - row) * PITCH_MM - above_mm
        medial = side - side.mean() + (col - middle) * PITCH_MM
        rows, cols = place.to_pixels(below, medial)
        if rows.min() < 0 or cols.min() < 0 or rows.max() > film.shape[0] - 1 or cols.max() > film.shape[1] - 1:
            continue
        patch = map_coordinates(film, np.meshgrid(rows, cols, indexing="ij"), order=1)
        if patch.mean() > 0 and np.ptp(patch) > 0:
            values |= {f"{name}_{key}": value for key, value in measure_texture(patch, pixel_mm).items()}
    return values


def _soft_tissue_grey(field: Array, outline: Outline) -> float:
    """Measure the mean grey value of soft tissue medial to the tibia, because the fibula is lateral."""
    heights = (outline.tibia_rows - np.median(outline.tibia)) * PITCH_MM
    chosen = (heights >= _BELOW_JOINT_MM[0]) & (heights <= _BELOW_JOINT_MM[1])
    rows, medial = outline.tibia_rows[chosen].astype(int), outline.tibia_sides[chosen, 1]
    beside = np.arange(*(round(length / PITCH_MM) for length in _SOFT_TISSUE_MM))
    cols = np.minimum(medial[:, None].astype(int) + beside, field.shape[1] - 1)
    return float(field[rows[:, None], cols].mean()) if len(rows) else float("nan")


def _joint_space_contrast(field: Array, outline: Outline) -> float:
    """Measure the contrast (bone - joint space) / (bone + joint space) of grey values in the medial compartment."""
    share = plateau_fractions(outline)
    chosen = (share > 0.15) & (share < 0.38)
    cols, femur, tibia = (part[chosen].astype(int) for part in (outline.columns, outline.femur, outline.tibia))
    space = field[(femur + tibia) // 2, cols].mean()
    within = np.arange(*(round(length / PITCH_MM) for length in _INSIDE_BONE_MM))[:, None]
    above, below = np.maximum(femur - within, 0), np.minimum(tibia + within, len(field) - 1)
    bone = (field[above, cols].mean() + field[below, cols].mean()) / 2
    return float((bone - space) / (bone + space))


def _plate_grey(field: Array, outline: Outline) -> float:
    """Measure the highest mean grey value at one depth, within 4 mm below the medial plateau contour."""
    share = plateau_fractions(outline)
    chosen = (share > 0.15) & (share < 0.38)
    cols, tibia = (part[chosen].astype(int) for part in (outline.columns, outline.tibia))
    deep = np.arange(round(4.0 / PITCH_MM) + 1)[:, None]
    return float(field[np.minimum(tibia + deep, len(field) - 1), cols].mean(axis=1).max())


def _shaft_greys(film: Array, place: JointPosition) -> tuple[float, float]:
    """Measure grey values of cortex and medullary canal of the tibial shaft; NaN if the shaft is outside the image."""
    below = np.arange(*_SHAFT_MM, PITCH_MM)
    across = np.arange(-_SHAFT_HALF_MM, _SHAFT_HALF_MM, PITCH_MM)
    rows, cols = place.to_pixels(below, across)
    if rows.max() > film.shape[0] - 1 or cols.min() < 0 or cols.max() > film.shape[1] - 1:
        return float("nan"), float("nan")
    profile = map_coordinates(film, np.meshgrid(rows, cols, indexing="ij"), order=1).mean(axis=0)
    inner = np.abs(across) < _CANAL_MM
    return float(np.percentile(profile, 95)), float(profile[inner].mean())
