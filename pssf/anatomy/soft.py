"""Soft tissue of a right knee: skin, subcutaneous fat, and what lies within the fascia."""

import numpy as np
from manifold3d import Manifold
from scipy import ndimage

from ..core.checks import Array
from ..data.soft import Effusion
from ..model.knee import Knee
from .bend import bend_of, sheared_deg
from .bone_build import Build, eased
from .muscles import FASCIA_POWER, intermuscular_fat
from .skin_folds import folded
from .solids import column_rings, loft

# Least tissue between bone and fascia; over the patella and the tibial crest there is hardly more.
_COVER_MM = 3.0
# A bent thigh goes back from here on.
THIGH_FROM_MM = 20.0
# Skin bends little along the leg: what lies within this of a plane is drawn as one.
_COARSER_MM = 0.03
# Of the limb's rings. A bent thigh comes nearer to the joint line, and goes on above the last of them by so much, so
# that its end stays out of the picture.
_LEVELS_MM = np.linspace(-205.0, 205.0, 38)
_LONGER_MM, _LONGER_PER_DEG_MM, _RING_MM = 150.0, 4.0, 11.0
_COUNT = 64


def layers(knee: Knee, build: Build, flexion_deg: float, bone_points_mm: Array) -> dict[str, Manifold]:
    """Nested solids "skin", "adipose" and "muscle", each filled to its outer surface; "intermuscular_fat" in the last.

    flexion_deg     of the femur, which the thigh follows
    bone_points_mm  (n, 3)  vertices of all bones in the leg's frame; the limb is made thick enough to hold them
    """
    table, size = build.shape.soft, build.shape.size
    fat, skin = knee.fat_mm, table.skin_mm
    wrap_ml, wrap_ap = fat + skin, max(2.0, fat * table.anterior_fat_share) + skin
    half_ml = size.male_tibial_ml_mm / 2 * build.scale + table.capsule_mm + wrap_ml
    rows = [[z, half_ml + more, knee.limb_ap_mm / 2 * share, y, 0.0] for z, more, share, y in table.sections]
    bend = bend_of(flexion_deg, build.scale)
    straight_mm = bend.straight(bone_points_mm)
    longer_mm = _longer_mm(bend.angle_deg, float(straight_mm[:, 2].max()))
    rows += [[rows[-1][0] + longer_mm, *rows[-1][1:]]] if longer_mm else []
    coarse = _follow_shafts(np.array(rows), sheared_deg(flexion_deg), build)
    # The patella stands in front of the limb's middle: where bone needs room the section moves there before it grows.
    coarse = _swollen(_resample(coarse), build.shape.effusion, knee.effusion_mm)
    fascia = _hold(coarse - np.array([0.0, wrap_ml, wrap_ap, 0.0, 0.0]), straight_mm)
    rings = np.append(_LEVELS_MM, np.arange(1.0, 1.0 + longer_mm // _RING_MM) * _RING_MM + _LEVELS_MM[-1])

    outer, fatty, within = (
        column_rings(fascia + np.array([0.0, ml_mm, ap_mm, 0.0, 0.0]), rings, FASCIA_POWER, _COUNT)
        for ml_mm, ap_mm in ((wrap_ml, wrap_ap), (wrap_ml - skin, wrap_ap - skin), (0.0, 0.0))
    )
    if knee.skin_folds > 0.0:
        outer, fatty = folded(outer, fatty, within, table.folds, knee.skin_folds, build.scale, knee.form_seed)
    solids = {
        name: loft(places, name).simplify(_COARSER_MM)
        for name, places in (("skin", outer), ("adipose", fatty), ("muscle", within))
    }
    solids["intermuscular_fat"] = intermuscular_fat(
        build.shape.muscles, build.shape.deep_fat, fascia, _LEVELS_MM, build.scale
    )
    return {name: bend.solid(solid, name) for name, solid in solids.items()}


def _longer_mm(angle_deg: float, femur_to_mm: float) -> float:
    """By how much a thigh goes on above the limb's rings: bent ones, and those whose femur reaches beyond them."""
    over_mm = femur_to_mm + 2 * _COVER_MM - _LEVELS_MM[-1]
    held_mm = float(np.ceil(over_mm / _RING_MM)) * _RING_MM if over_mm > 0.0 else 0.0
    return max(min(_LONGER_MM, _LONGER_PER_DEG_MM * angle_deg), held_mm)


def _resample(sections: Array) -> Array:
    heights = np.linspace(sections[0, 0], sections[-1, 0], 28)
    return np.column_stack([heights, *(np.interp(heights, sections[:, 0], sections[:, k]) for k in range(1, 5))])


def _swollen(sections: Array, table: Effusion, effusion_mm: float) -> Array:
    """Sections with room for an effusion."""
    more_mm = effusion_mm * np.interp(sections[:, 0], *np.array(table.about).T)
    swollen = sections.copy()
    swollen[:, 1] += table.medial / 2 * more_mm
    swollen[:, 4] += table.medial / 2 * more_mm
    swollen[:, 2] += table.front_and_back * more_mm
    return swollen


def _hold(sections: Array, points_mm: Array) -> Array:
    """Sections moved and widened, where they must be, until every point lies within by the least cover."""
    held = sections.copy()
    reach = np.abs(np.diff(sections[:, 0])).max() * 1.5
    bands = [points_mm[np.abs(points_mm[:, 2] - z) < reach] for z in sections[:, 0]]
    for row, near in zip(held, bands, strict=True):
        for half, centre, axis in ((1, 4, 0), (2, 3, 1)) if len(near) else ():
            low, high = near[:, axis].min() - 2 * _COVER_MM, near[:, axis].max() + 2 * _COVER_MM
            row[centre] = np.clip(row[centre], min(high - row[half], row[centre]), max(low + row[half], row[centre]))
    held[:, 3:] = ndimage.uniform_filter1d(held[:, 3:], 5, axis=0, mode="nearest")
    growth = np.ones(len(held))
    for k, near in enumerate(bands):
        if len(near):
            x = np.abs(near[:, 0] - held[k, 4]) / (held[k, 1] - _COVER_MM)
            y = np.abs(near[:, 1] - held[k, 3]) / (held[k, 2] - _COVER_MM)
            growth[k] = max(1.0, float((x**FASCIA_POWER + y**FASCIA_POWER).max() ** (1 / FASCIA_POWER)))
    # The mean of a running maximum of the same width is never below the growth itself, and has no steps.
    growth = ndimage.uniform_filter1d(ndimage.maximum_filter1d(growth, 9, mode="nearest"), 9, mode="nearest")
    held[:, 1:3] *= growth[:, None]
    return held


def _follow_shafts(sections: Array, flexion_deg: float, build: Build) -> Array:
    """Thigh and calf lean with their bones."""
    leaning = sections.copy()
    for axis, from_mm, degrees, end in (
        (4, 40.0, -build.femur_valgus_deg * 0.6, +1),
        (4, -25.0, build.tibia_varus_deg, -1),
        (3, THIGH_FROM_MM, flexion_deg, +1),
    ):
        leaning[:, axis] += np.tan(np.deg2rad(degrees)) * eased(end * (sections[:, 0] - from_mm))
    return leaning
