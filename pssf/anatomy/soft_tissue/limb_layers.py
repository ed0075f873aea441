"""Soft-tissue layers of a right knee: skin, subcutaneous fat and the volume within the fascia."""

import numpy as np
from manifold3d import Manifold
from scipy import ndimage

from ...core.checks import Array
from ...data.anatomy.soft_tissue_tables import EffusionShape
from ...model.knee import Knee
from ..meshing.solids import loft, make_column_rings
from ..template.bone_builder import BoneParameters, smooth_ramp_mm
from .limb_bend import build_limb_bend, shear_angle_deg
from .muscles import FASCIA_POWER, build_intermuscular_fat
from .skin_folds import add_skin_folds

# Smallest tissue thickness between bone and fascia, in mm. The tissue over the patella and the tibial crest is only
# slightly thicker.
_MIN_COVER_MM = 3.0
# Height above the joint line at which the backward lean of the flexed thigh begins, in mm.
THIGH_START_Z_MM = 20.0
# Tolerance for simplifying the soft-tissue meshes, in mm. The skin has little curvature along the leg.
_SIMPLIFY_TOLERANCE_MM = 0.03
# Heights of the rings of the limb, in mm.
_LEVELS_MM = np.linspace(-205.0, 205.0, 38)
# Largest upward extension of the thigh, in mm. Flexion moves the end of the thigh towards the joint line. The extension
# keeps the end outside the image.
_LONGER_MM = 150.0
# Extension of the thigh per degree of bending, in mm.
_LONGER_PER_DEG_MM = 4.0
# Distance between the rings of the thigh extension, in mm.
_RING_MM = 11.0
# Number of points per ring of the limb.
_COUNT = 64


def build_soft_tissue_layers(
    knee: Knee, bone_parameters: BoneParameters, flexion_deg: float, bone_points_mm: Array
) -> dict[str, Manifold]:
    """Build the nested soft-tissue layers of the limb.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee: fat, limb thickness, effusion and skin folds.
    bone_parameters : BoneParameters
        Size, alignment and template anatomy of the bones.
    flexion_deg : float
        Flexion of the femur, in degrees. The thigh is flexed by the same angle.
    bone_points_mm : (n, 3) float64 array
        Vertices of all bones in the frame of the leg, in mm. The limb is widened where it would not enclose them.

    Returns
    -------
    dict of str to Manifold
        Solids ``"skin"``, ``"adipose"`` and ``"muscle"``, each of which includes all tissue inside its outer surface,
        and ``"intermuscular_fat"``, which is inside ``"muscle"``. All solids are in the frame of the leg, in mm.

    Raises
    ------
    InputError
        If the flexed limb would fold behind the knee.
    """
    table, size = bone_parameters.shape.soft, bone_parameters.shape.size
    fat, skin = knee.fat_mm, table.skin_mm
    wrap_ml, wrap_ap = fat + skin, max(2.0, fat * table.anterior_fat_share) + skin
    half_ml = size.male_tibial_ml_mm / 2 * bone_parameters.scale + table.capsule_mm + wrap_ml
    rows = [[z, half_ml + more, knee.limb_ap_mm / 2 * share, y, 0.0] for z, more, share, y in table.sections]
    bend = build_limb_bend(flexion_deg, bone_parameters.scale)
    straight_mm = bend.straighten_points(bone_points_mm)
    longer_mm = _compute_thigh_extension_mm(bend.angle_deg, float(straight_mm[:, 2].max()))
    rows += [[rows[-1][0] + longer_mm, *rows[-1][1:]]] if longer_mm else []
    coarse = _lean_with_shafts(np.array(rows), shear_angle_deg(flexion_deg), bone_parameters)
    # The patella is anterior to the limb centre. If a section is too small to enclose the bones, the section is
    # therefore moved towards the bones before it is widened.
    coarse = _add_effusion(_resample(coarse), bone_parameters.shape.effusion, knee.effusion_mm)
    fascia = _enclose_points(coarse - np.array([0.0, wrap_ml, wrap_ap, 0.0, 0.0]), straight_mm)
    rings = np.append(_LEVELS_MM, np.arange(1.0, 1.0 + longer_mm // _RING_MM) * _RING_MM + _LEVELS_MM[-1])

    outer, fatty, within = (
        make_column_rings(fascia + np.array([0.0, ml_mm, ap_mm, 0.0, 0.0]), rings, FASCIA_POWER, _COUNT)
        for ml_mm, ap_mm in ((wrap_ml, wrap_ap), (wrap_ml - skin, wrap_ap - skin), (0.0, 0.0))
    )
    if knee.skin_folds > 0.0:
        outer, fatty = add_skin_folds(
            outer, fatty, within, table.folds, knee.skin_folds, bone_parameters.scale, knee.form_seed
        )
    solids = {
        name: loft(places, name).simplify(_SIMPLIFY_TOLERANCE_MM)
        for name, places in (("skin", outer), ("adipose", fatty), ("muscle", within))
    }
    solids["intermuscular_fat"] = build_intermuscular_fat(
        bone_parameters.shape.muscles, bone_parameters.shape.deep_fat, fascia, _LEVELS_MM, bone_parameters.scale
    )
    return {name: bend.bend_solid(solid, name) for name, solid in solids.items()}


def _compute_thigh_extension_mm(angle_deg: float, femur_to_mm: float) -> float:
    """Return the length of the thigh above the highest ring of the limb, in mm.

    An extension is needed if the thigh is bent or if the femur ends above the rings.
    """
    over_mm = femur_to_mm + 2 * _MIN_COVER_MM - _LEVELS_MM[-1]
    held_mm = float(np.ceil(over_mm / _RING_MM)) * _RING_MM if over_mm > 0.0 else 0.0
    return max(min(_LONGER_MM, _LONGER_PER_DEG_MM * angle_deg), held_mm)


def _resample(sections: Array) -> Array:
    """Interpolate sections (n, 5) to 28 equally spaced heights.

    The columns are z, half ML, half AP, centre y and centre x, in mm.
    """
    heights = np.linspace(sections[0, 0], sections[-1, 0], 28)
    return np.column_stack([heights, *(np.interp(heights, sections[:, 0], sections[:, k]) for k in range(1, 5))])


def _add_effusion(sections: Array, table: EffusionShape, effusion_mm: float) -> Array:
    """Widen sections (n, 5) and shift them medially to contain an effusion."""
    more_mm = effusion_mm * np.interp(sections[:, 0], *np.array(table.height_profile).T)
    swollen = sections.copy()
    swollen[:, 1] += table.medial / 2 * more_mm
    swollen[:, 4] += table.medial / 2 * more_mm
    swollen[:, 2] += table.front_and_back * more_mm
    return swollen


def _enclose_points(sections: Array, points_mm: Array) -> Array:
    """Move and widen sections (n, 5) until they enclose all points (n, 3), in mm.

    The smallest allowed tissue thickness remains between points and sections.
    """
    held = sections.copy()
    reach = np.abs(np.diff(sections[:, 0])).max() * 1.5
    bands = [points_mm[np.abs(points_mm[:, 2] - z) < reach] for z in sections[:, 0]]
    for row, near in zip(held, bands, strict=True):
        for half, centre, axis in ((1, 4, 0), (2, 3, 1)) if len(near) else ():
            low, high = near[:, axis].min() - 2 * _MIN_COVER_MM, near[:, axis].max() + 2 * _MIN_COVER_MM
            row[centre] = np.clip(row[centre], min(high - row[half], row[centre]), max(low + row[half], row[centre]))
    held[:, 3:] = ndimage.uniform_filter1d(held[:, 3:], 5, axis=0, mode="nearest")
    growth = np.ones(len(held))
    for k, near in enumerate(bands):
        if len(near):
            x = np.abs(near[:, 0] - held[k, 4]) / (held[k, 1] - _MIN_COVER_MM)
            y = np.abs(near[:, 1] - held[k, 3]) / (held[k, 2] - _MIN_COVER_MM)
            growth[k] = max(1.0, float((x**FASCIA_POWER + y**FASCIA_POWER).max() ** (1 / FASCIA_POWER)))
    # A moving average of a moving maximum with the same window is smooth and never below the original growth factor.
    growth = ndimage.uniform_filter1d(ndimage.maximum_filter1d(growth, 9, mode="nearest"), 9, mode="nearest")
    held[:, 1:3] *= growth[:, None]
    return held


def _lean_with_shafts(sections: Array, flexion_deg: float, bone_parameters: BoneParameters) -> Array:
    """Shift sections (n, 5) to make the thigh and the calf lean together with their bone shafts."""
    leaning = sections.copy()
    for axis, from_mm, degrees, end in (
        (4, 40.0, -bone_parameters.femur_valgus_deg * 0.6, +1),
        (4, -25.0, bone_parameters.tibia_varus_deg, -1),
        (3, THIGH_START_Z_MM, flexion_deg, +1),
    ):
        leaning[:, axis] += np.tan(np.deg2rad(degrees)) * smooth_ramp_mm(end * (sections[:, 0] - from_mm))
    return leaning
