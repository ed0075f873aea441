"""Bone deformation: map points of the template bones to the bones of one knee.

A template bone has its own frame, the mean male size and a straight shaft. A free-form lattice deforms it into the bone
of one person. Beyond the lattice, the shaft continues straight. The bone is then rotated until its shaft is upright in
the sagittal plane. Finally, the tibial plateau gets its posterior slope, and each shaft gets its lean in the frontal
plane. The bone shape therefore does not change the specified angles of a knee.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...core.checks import Array
from ...data.anatomy.anatomy_tables import AnatomyTables
from ...data.anatomy.bone_tables import (
    FemurShape,
    GrowthZone,
    RoughnessZone,
    TemplateAnatomy,
    TibiaShape,
)
from ...data.anatomy.trabecular_table import TrabecularBone
from ...data.table_records import Rows
from ...geometry.freeform_deformation import Lattice, displace_points
from ...model.knee import Knee
from ..meshing.solids import SHAFT_POWER, make_ring
from .bone_form import build_lattices, build_shape_model
from .bone_roughness import (
    NO_SEEDS,
    Seeds,
    compute_growth_mm,
    compute_roughness_mm,
)
from .template_bone import SubchondralPlates, TemplateBone
from .template_femur import make_template_femur
from .template_tibia import make_template_tibia, plateau_height_mm

# Start of the shaft segment in which the lean of the shaft is measured, mm from the joint at template size.
_LEAN_FROM_MM = 55.0
# End of this segment, mm from the joint at template size. Beyond it, the shaft continues straight with this lean.
_LEAN_TO_MM = 85.0
# Distances from the joint between which the angle of the shaft is measured, mm at the size of the knee.
_SHAFT_MM = (115.0, 165.0)
# Number of points per ring that is used to compute the centre of a shaft section.
_RING_POINTS = 48
# Distance from the joint end to the point that represents the epiphysis, mm at template size.
_EPIPHYSIS_MM = 15.0
# Length over which the lean of a shaft increases smoothly, mm; without it, the metaphysis would have a kink.
_RAMP_LENGTH_MM = 15.0
# Medio-lateral distance from the centre to the points at which the slope of the plateau is measured, mm.
_PLATEAU_X_MM = 22.0
# Antero-posterior distance from the centre to these points, mm.
_PLATEAU_Y_MM = 13.0
# Number of fixed-point iterations that find these points on the deformed plateau.
_PLATEAU_ITERATIONS = 4
# Depth below the plateau at which the tibial slope reaches 0, mm at template size; this depth is below the tuberosity.
_SLOPE_END_MM = 60.0


@dataclass(frozen=True, kw_only=True)
class BoneDeformation:
    """Deformation of the template femur or tibia into the bone of one person.

    Attributes
    ----------
    lattice : Lattice
        Free-form deformation at template size, in the frame of the bone.
    shaft_sign : int
        +1 if the shaft points up from the joint (femur), -1 if it points down (tibia).
    roughness_zones : tuple of RoughnessZone
        Zones with a rough surface.
    seeds : Seeds
        Seeds of the surface roughness.
    growth_zones : tuple of GrowthZone
        Zones in which bone has grown.
    bone_growth_mm : float
        Amount of growth, in mm at template size.
    shaft_lean_xy : (float, float)
        Lean of the shaft beyond the lattice, along x and y, in mm per mm of distance from the joint.
    frontal_lean : float
        Lean of the shaft along x after the upright rotation, in mm per mm of distance from the joint.
    """

    lattice: Lattice
    shaft_sign: int
    roughness_zones: tuple[RoughnessZone, ...] = ()
    seeds: Seeds = NO_SEEDS
    growth_zones: tuple[GrowthZone, ...] = ()
    bone_growth_mm: float = 0.0
    shaft_lean_xy: tuple[float, float] = (0.0, 0.0)
    frontal_lean: float = 0.0

    def upright_rotation(self) -> Array:
        """Compute the rotation about x that makes the shaft upright in the sagittal plane.

        Returns
        -------
        (3, 3) float64 array
            Rotation matrix.
        """
        turn = self.shaft_sign * np.arctan(self.shaft_lean_xy[1])
        cos, sin = np.cos(turn), np.sin(turn)
        return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])

    def epiphysis_transform(self, scale: float) -> Array:
        """Compute the rigid transform of the epiphysis from the template frame to the frame of the bone.

        Parameters
        ----------
        scale : float
            Size of the bone relative to the template, dimensionless.

        Returns
        -------
        (3, 4) float64 array
            Rotation and translation (mm). Structures near the joint, such as the trabecular lattice, follow this
            transform.
        """
        joint = np.array([[0.0, 0.0, self.shaft_sign * _EPIPHYSIS_MM]])
        turn = self.upright_rotation()
        return np.column_stack((turn, (deform_template_points(joint, self) - joint @ turn.T)[0] * scale))


@dataclass(frozen=True)
class BoneParameters:
    """Parameters that determine the bones of one knee.

    Attributes
    ----------
    tables : AnatomyTables
        Tables of the template anatomy, the shape model and the trabecular bone.
    femur : BoneDeformation
        Deformation of the template femur.
    tibia : BoneDeformation
        Deformation of the template tibia.
    patella : Lattice
        Deformation of the template patella.
    scale : float
        Size of the bones relative to the template, dimensionless.
    cortex_scale : float
        Thickness of the cortex relative to the template, dimensionless.
    plates : SubchondralPlates
        Thickness of the subchondral bone plates relative to the template.
    slope_deg : float
        Posterior tibial slope, mean of the medial and lateral compartment, in degrees.
    plateau_fall_per_mm : float
        Posterior slope of the deformed plateau before the specified slope is applied, in mm per mm.
    femur_valgus_deg : float
        Angle by which the femoral shaft leans laterally towards its proximal end, in degrees.
    tibia_varus_deg : float
        Angle by which the tibial shaft leans medially towards its distal end, in degrees.
    seed : int
        Seed of the variation in cortical thickness.
    """

    tables: AnatomyTables
    femur: BoneDeformation
    tibia: BoneDeformation
    patella: Lattice
    scale: float
    cortex_scale: float
    plates: SubchondralPlates
    slope_deg: float
    plateau_fall_per_mm: float
    femur_valgus_deg: float
    tibia_varus_deg: float
    seed: int

    @property
    def shape(self) -> TemplateAnatomy:
        """Shape tables of the template bones."""
        return self.tables.template

    @property
    def template_femur(self) -> TemplateBone:
        """Template femur."""
        return make_template_femur(self.tables.template.femur, self.tables.shape_model)

    @property
    def template_tibia(self) -> TemplateBone:
        """Template tibia."""
        return make_template_tibia(self.tables.template.tibia, self.tables.shape_model)

    @property
    def half_ml_mm(self) -> float:
        """Half the medio-lateral width of the tibial plateau, in mm."""
        return self.shape.size.male_tibial_ml_mm / 2 * self.scale


def resolve_bone_parameters(knee: Knee, tables: AnatomyTables) -> BoneParameters:
    """Compute the deformations of the template bones from the parameters of a knee.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    tables : AnatomyTables
        Tables of the template anatomy.

    Returns
    -------
    BoneParameters
        Deformations, sizes and angles of the bones.
    """
    shape, size = tables.template, tables.template.size
    sex_scale = size.female_over_male if knee.sex == "female" else 1.0
    scale = sex_scale * knee.bone_scale * knee.stature_mm / getattr(size.stature_mm, knee.sex)
    lattices = build_lattices(knee.shape, build_shape_model(tables.shape_model))
    seeds = Seeds(texture=knee.texture_seed, form=knee.form_seed)
    femur, tibia = (
        replace(
            _fit_deformation(lattices[name], end, getattr(shape, name), scale, seeds),
            growth_zones=getattr(shape.notch_growth, name),
            bone_growth_mm=knee.notch_growth_mm / scale,
        )
        for name, end in (("femur", +1), ("tibia", -1))
    )
    # The tibial shaft keeps the lean that its shape gives. The lean of the femoral shaft gives a straight leg its
    # normal angle. An additional varus angle is divided equally between femur and tibia.
    varus = float(np.rad2deg(np.arctan(tibia.frontal_lean)))
    return BoneParameters(
        tables=tables,
        femur=femur,
        tibia=tibia,
        patella=lattices["patella"],
        scale=scale,
        cortex_scale=knee.cortex_scale,
        plates=_resolve_plates(knee, scale, tables.trabecular_bone),
        slope_deg=knee.tibial_slope_deg,
        plateau_fall_per_mm=compute_plateau_fall_per_mm(tibia, shape.tibia),
        femur_valgus_deg=shape.femur.valgus_deg + varus - knee.varus_deg / 2,
        tibia_varus_deg=varus + knee.varus_deg / 2,
        seed=knee.texture_seed,
    )


def _resolve_plates(knee: Knee, scale: float, spongy: TrabecularBone) -> SubchondralPlates:
    """Compute the thickness of the subchondral bone plates relative to the template.

    Sclerosis thickens the plate on the sclerotic side. The plate on the other side gets a fraction of this thickening.
    """
    healthy = knee.cortex_scale / scale
    excess, share = knee.subchondral_plate - 1, spongy.sclerosis.other_side
    thick, other = healthy * (1 + excess), healthy * (1 + share * excess)
    medial, lateral = (thick, other) if knee.sclerotic_side == "medial" else (other, thick)
    return SubchondralPlates(medial, lateral, spongy.side.middle_mm)


def _fit_deformation(
    lattice: Lattice, shaft_sign: int, shape: FemurShape | TibiaShape, scale: float, seeds: Seeds
) -> BoneDeformation:
    """Measure the lean of a deformed shaft and return the complete deformation of the bone."""
    sections = shape.sections
    heights = np.linspace(_LEAN_FROM_MM, _LEAN_TO_MM, 5)
    middles = _compute_section_centres(sections, shaft_sign * heights, lambda points: displace_points(points, lattice))
    lean_x, lean_y = np.polyfit(heights, middles, 1)[0]
    lean = (float(lean_x), float(lean_y))
    form = BoneDeformation(
        lattice=lattice, shaft_sign=shaft_sign, roughness_zones=shape.roughness_zones, seeds=seeds, shaft_lean_xy=lean
    )
    heights = np.array(_SHAFT_MM) / scale
    far = _compute_section_centres(sections, shaft_sign * heights, lambda points: deform_template_points(points, form))
    return replace(form, frontal_lean=float(np.diff(far[:, 0])[0] / np.diff(heights)[0]))


def _compute_section_centres(sections: Rows, heights: Array, move: Callable[[Array], Array]) -> Array:
    """Compute the centres (n, 2) of shaft sections at heights (n,) after `move` has displaced them, mm."""
    rows = scale_sections(sections, 1.0)
    rows = rows[np.argsort(rows[:, 0])]
    middles = []
    for z in heights:
        half_x, half_y, y, x = (float(np.interp(z, rows[:, 0], rows[:, k])) for k in range(1, 5))
        places = move(make_ring(half_x, half_y, (x, y, z), SHAFT_POWER, _RING_POINTS))[:, :2]
        middles.append((places.min(axis=0) + places.max(axis=0)) / 2)
    return np.array(middles)


def deform_template_points(points: Array, deformation: BoneDeformation) -> Array:
    """Deform points of a template bone into the bone of one person, at template size, with an upright shaft.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points in the frame of the template bone.
    deformation : BoneDeformation
        Deformation of the bone.

    Returns
    -------
    (n, 3) float64 array
        Points of the deformed bone at template size, in mm. The shaft is upright in the sagittal plane.
    """
    beyond = np.maximum(deformation.shaft_sign * points[:, 2] - _LEAN_TO_MM, 0.0)
    # Beyond the end of the lattice, the displacements stay constant and the shaft continues straight.
    places = displace_points(points - beyond[:, None] * [0.0, 0.0, deformation.shaft_sign], deformation.lattice)
    places += beyond[:, None] * [*deformation.shaft_lean_xy, deformation.shaft_sign] + compute_roughness_mm(
        points, deformation.roughness_zones, deformation.seeds, deformation.shaft_sign
    )
    places += compute_growth_mm(points, deformation.growth_zones, deformation.bone_growth_mm)
    return places @ deformation.upright_rotation().T


def smooth_ramp_mm(beyond_mm: Array) -> Array:
    """Compute a ramp that is 0 before a point, starts smoothly and then increases with slope 1.

    Parameters
    ----------
    beyond_mm : (n,) float64 array
        Signed distance beyond the start of the ramp, in mm.

    Returns
    -------
    (n,) float64 array
        Value of the ramp, in mm. It increases quadratically over the first 15 mm.
    """
    beyond = np.maximum(beyond_mm, 0.0)
    return np.where(beyond < _RAMP_LENGTH_MM, beyond**2 / (2 * _RAMP_LENGTH_MM), beyond - _RAMP_LENGTH_MM / 2)


def map_template_femur(points: Array, bone_parameters: BoneParameters) -> Array:
    """Map points of the template femur into the femur of one knee.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points in the frame of the template femur.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    (n, 3) float64 array
        Points of the deformed, scaled femur with its lean, in the frame of the femur, in mm.
    """
    return scale_and_lean_femur(deform_template_points(points, bone_parameters.femur), bone_parameters)


def map_template_tibia(points: Array, bone_parameters: BoneParameters) -> Array:
    """Map points of the template tibia into the tibia of one knee.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points in the frame of the template tibia.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    (n, 3) float64 array
        Points of the deformed, scaled tibia with its slope and lean, in the frame of the tibia, in mm.
    """
    return scale_slope_and_lean_tibia(deform_template_points(points, bone_parameters.tibia), bone_parameters)


def scale_and_lean_femur(places: Array, bone_parameters: BoneParameters) -> Array:
    """Scale a deformed femur to the size of the knee and apply the lean of its shaft.

    Parameters
    ----------
    places : (n, 3) float64 array, mm
        Points at template size, as `deform_template_points` returns them.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    (n, 3) float64 array
        Points in the frame of the femur, in mm.
    """
    slope = -np.tan(np.deg2rad(bone_parameters.femur_valgus_deg)) - bone_parameters.femur.frontal_lean
    return _lean_shaft(
        places * bone_parameters.scale, bone_parameters, bone_parameters.shape.femur.shaft_pivot_z_mm, +1, slope
    )


def scale_slope_and_lean_tibia(places: Array, bone_parameters: BoneParameters) -> Array:
    """Scale a deformed tibia to the size of the knee and apply the slope of its plateau and the lean of its shaft.

    Parameters
    ----------
    places : (n, 3) float64 array, mm
        Points at template size, as `deform_template_points` returns them.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    (n, 3) float64 array
        Points in the frame of the tibia, in mm.
    """
    slope = np.tan(np.deg2rad(bone_parameters.tibia_varus_deg)) - bone_parameters.tibia.frontal_lean
    leant = apply_tibial_slope(places * bone_parameters.scale, bone_parameters)
    return _lean_shaft(leant, bone_parameters, bone_parameters.shape.tibia.shaft_pivot_z_mm, -1, slope)


def _lean_shaft(
    places: Array, bone_parameters: BoneParameters, pivot_mm: float, shaft_sign: int, slope: float
) -> Array:
    """Shift points (n, 3) along x in place, in proportion to their distance beyond the pivot of the shaft, mm."""
    places[:, 0] += slope * smooth_ramp_mm(shaft_sign * (places[:, 2] - pivot_mm * bone_parameters.scale))
    return places


def apply_tibial_slope(points_mm: Array, bone_parameters: BoneParameters) -> Array:
    """Apply the posterior slope to the tibial plateau.

    Parameters
    ----------
    points_mm : (n, 3) float64 array
        Points of a tibia at the size of the knee, in mm.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    (n, 3) float64 array
        Points after the slope is applied, in mm. The slope decreases with depth; the shaft below the tuberosity stays
        unchanged.
    """
    places = points_mm.copy()
    fade = np.clip(1 + places[:, 2] / (_SLOPE_END_MM * bone_parameters.scale), 0.0, 1.0) ** 2
    places[:, 2] -= (
        (np.tan(np.deg2rad(bone_parameters.slope_deg)) - bone_parameters.plateau_fall_per_mm) * places[:, 1] * fade
    )
    return places


def compute_plateau_fall_per_mm(deformation: BoneDeformation, shape: TibiaShape) -> float:
    """Compute the posterior slope of a deformed plateau before the specified slope is applied.

    Parameters
    ----------
    deformation : BoneDeformation
        Deformation of the tibia.
    shape : TibiaShape
        Table of the template tibia.

    Returns
    -------
    float
        Decrease in height towards posterior, in mm per mm, mean of the medial and lateral compartment.
    """
    x, y = np.repeat([_PLATEAU_X_MM, -_PLATEAU_X_MM], 2), np.tile([-_PLATEAU_Y_MM, _PLATEAU_Y_MM], 2)
    places = np.column_stack((x, y, plateau_height_mm(x, y, shape.relief)))
    # The slope is measured at fixed x and y of the deformed plateau, so the template points are found by iteration.
    for _ in range(_PLATEAU_ITERATIONS):
        places[:, :2] -= deform_template_points(places, deformation)[:, :2] - np.column_stack((x, y))
        places[:, 2] = plateau_height_mm(places[:, 0], places[:, 1], shape.relief)
    heights = deform_template_points(places, deformation)[:, 2]
    return float(np.mean(heights[::2] - heights[1::2]) / (2 * _PLATEAU_Y_MM))


def scale_sections(sections: object, scale: float) -> Array:
    """Scale a table of lengths.

    Parameters
    ----------
    sections : sequence of rows, or (n, m) array
        Table of lengths, in mm.
    scale : float
        Factor, dimensionless.

    Returns
    -------
    (n, m) float64 array
        Scaled table, in mm.
    """
    return np.asarray(sections, dtype=np.float64) * scale
