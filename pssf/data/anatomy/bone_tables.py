"""Template anatomy: shape of an average male right knee (``data/anatomy.toml``), in mm and degrees.

Axes: x medial, y posterior, z proximal. ML is mediolateral, and AP anteroposterior. Rows of ``sections`` are height z,
half ML width, half AP depth, centre y and centre x. Rows of ``cortex`` are height z and cortical thickness.
"""

from functools import cache
from typing import Literal

from ..data_files import load_data_table
from ..table_records import (
    Pair,
    Record,
    Rows,
    Triple,
    parse_record,
)
from .soft_tissue_tables import (
    Cartilage,
    DeepFat,
    EffusionShape,
    FatPad,
    LimbShape,
    Menisci,
    MuscleShape,
    PatellarTendon,
    QuadricepsTendon,
)


class Ellipsoid(Record, frozen=True):
    """Ellipsoid that is added to a bone or removed from it.

    Attributes
    ----------
    centre : (float, float, float)
        Centre, in mm.
    half : (float, float, float)
        Semi-axes, in mm.
    fillet_mm : float
        Radius of the fillet between ellipsoid and bone, in mm.
    """

    centre: Triple
    half: Triple
    fillet_mm: float


class NotchShape(Record, frozen=True):
    """Shape of the intercondylar notch.

    Attributes
    ----------
    fillet_mm : float
        Radius of the fillet between notch and femur, in mm.
    cortex_mm : float
        Cortical thickness of the walls of the notch, in mm.
    sections : rows of float
        Rows of y (mm), height of the roof (mm), curvature of the arch (1/mm), and half width (mm).
    flare : float
        Increase of the half width per mm below the roof.
    """

    fillet_mm: float
    cortex_mm: float
    sections: Rows
    flare: float


class Condyle(Record, frozen=True):
    """Shape of one femoral condyle.

    Attributes
    ----------
    x, y : float
        Centre, in mm.
    low_z : float
        Height of the lowest point, in mm.
    back, front : float
        Half extents in posterior and in anterior direction, in mm.
    up, down : float
        Half extents in proximal and in distal direction, in mm.
    outer, inner : float
        Half extents away from the notch and towards the notch, in mm.
    outer_power, inner_power : float
        Exponents of the superelliptic coronal outline; 2 is an ellipse, and larger values are more rectangular.
    rise : float
        Slope of the surface from the middle of the condyle away from the notch, in mm per mm.
    """

    x: float
    y: float
    low_z: float
    back: float
    front: float
    up: float
    down: float
    outer: float
    inner: float
    outer_power: float
    inner_power: float
    rise: float


class Condyles(Record, frozen=True):
    """Shapes of both femoral condyles.

    Attributes
    ----------
    medial : Condyle
        Shape of the medial condyle.
    lateral : Condyle
        Shape of the lateral condyle.
    """

    medial: Condyle
    lateral: Condyle


class RoughnessZone(Record, frozen=True):
    """Zone of a bone with a rough surface: points inside an ellipsoid are displaced by random waves.

    Attributes
    ----------
    centre : (float, float, float)
        Centre of the ellipsoid, in mm.
    half : (float, float, float)
        Semi-axes of the ellipsoid, in mm.
    direction : (float, float, float)
        Direction of the displacement, as a unit vector.
    sd_mm : float
        SD of the displacement, in mm.
    lengths_mm : (float, float)
        Shortest and longest wavelength, in mm.
    seed_stream : {"texture", "form"}
        Seed of the waves: `Knee.texture_seed` or `Knee.form_seed`.
    """

    centre: Triple
    half: Triple
    direction: Triple
    sd_mm: float
    lengths_mm: Pair
    seed_stream: Literal["texture", "form"]


class GrowthZone(Record, frozen=True):
    """Ellipsoid in which bone growth displaces points; the displacement decreases to 0 at the ellipsoid surface.

    Attributes
    ----------
    centre : (float, float, float)
        Centre of the ellipsoid, in mm.
    half : (float, float, float)
        Semi-axes of the ellipsoid, in mm.
    direction : (float, float, float)
        Displacement at the centre, in mm per mm of growth.
    """

    centre: Triple
    half: Triple
    direction: Triple


class NotchGrowthZones(Record, frozen=True):
    """Zones of bone growth that narrows the notch.

    Attributes
    ----------
    femur : tuple of GrowthZone
        Walls and roof of the notch, and the lateral condyle.
    tibia : tuple of GrowthZone
        Intercondylar eminence and floors of the plateaus.
    """

    femur: tuple[GrowthZone, ...]
    tibia: tuple[GrowthZone, ...]


class FemurShape(Record, frozen=True):
    """Distal femur; z = 0 at the distal end of the condyles.

    Attributes
    ----------
    valgus_deg : float
        Angle between the anatomical axis of the shaft and the mechanical axis, in degrees.
    shaft_pivot_z_mm : float
        Height of the pivot about which the shaft is rotated, in mm.
    edge_mm : float
        Longest mesh edge, in mm.
    tolerance_mm : float
        Largest distance between the midpoint of a mesh edge and the bone surface, in mm; beyond this distance, the edge
        is split.
    fillet_mm : float
        Radius of the fillets between shaft, trochlea and condyles, in mm.
    trochlea_end_z : float
        Height of the lower edge of the trochlea at its middle, in mm.
    trochlea_end_bend : float
        Curvature of the lower edge of the trochlea: decrease of its height per square of the distance from its middle,
        in 1/mm.
    sections : rows of float
        Cross-sections of shaft and metaphysis before the valgus rotation of the shaft, in mm.
    bumps : tuple of Ellipsoid
        Epicondyles and adductor tubercle.
    hollows : tuple of Ellipsoid
        Trochlear and popliteal groove.
    cortex : rows of float
        Rows of height z and cortical thickness, in mm.
    plate_mm : float
        Thickness of the subchondral bone plate of the condyles, in mm.
    plate_below_z : float
        Height below which the bone has a subchondral bone plate, in mm.
    plate_within_x : float
        Distance from the middle within which the bone has a subchondral bone plate, in mm.
    canal_from_z_mm : float
        Height at which the medullary canal begins, in mm.
    canal_full_z_mm : float
        Height at which the canal has its full width, in mm.
    notch : NotchShape
        Shape of the intercondylar notch.
    condyles : Condyles
        Shapes of both condyles.
    roughness_zones : tuple of RoughnessZone
        Zones with a rough surface.
    """

    valgus_deg: float
    shaft_pivot_z_mm: float
    edge_mm: float
    tolerance_mm: float
    fillet_mm: float
    trochlea_end_z: float
    trochlea_end_bend: float
    sections: Rows
    bumps: tuple[Ellipsoid, ...]
    hollows: tuple[Ellipsoid, ...]
    cortex: Rows
    plate_mm: float
    plate_below_z: float
    plate_within_x: float
    canal_from_z_mm: float
    canal_full_z_mm: float
    notch: NotchShape
    condyles: Condyles
    roughness_zones: tuple[RoughnessZone, ...]


class CorticalThicknessVariation(Record, frozen=True):
    """Random variation of cortical thickness along a bone.

    Attributes
    ----------
    sd : float
        SD relative to the mean thickness, for cortex of thickness `thin_mm` or less.
    thin_mm : float
        Cortical thickness above which the absolute SD is constant, in mm.
    least_mm : float
        Smallest thickness, in mm.
    shortest_mm : float
        Shortest wavelength of the variation, in mm.
    longest_mm : float
        Longest wavelength of the variation, in mm.
    """

    sd: float
    thin_mm: float
    least_mm: float
    shortest_mm: float
    longest_mm: float


class PlateauGaussian(Record, frozen=True):
    """Gaussian elevation of the tibial plateau, or depression if the height is negative.

    Attributes
    ----------
    x, y : float
        Centre, in mm.
    height : float
        Height of the elevation, in mm; negative for a depression.
    half_x, half_y : float
        Half widths, in mm.
    """

    x: float
    y: float
    height: float
    half_x: float
    half_y: float


class TibiaShape(Record, frozen=True):
    """Proximal tibia; z = 0 at the middle of the plateau.

    Attributes
    ----------
    sections : rows of float
        Rows of height z, half ML width, half AP depth, centre y and centre x, in mm.
    deeper_medially : float
        Relative increase of the AP depth with x, in 1/mm; the medial side is deeper.
    deeper_above_z : float
        Height below which the AP depth does not depend on x, in mm.
    shaft_pivot_z_mm : float
        Height of the pivot about which the shaft is rotated, in mm.
    cortex : rows of float
        Rows of height z and cortical thickness, in mm.
    plate_mm : float
        Thickness of the subchondral bone plate at the margins and between the condyles, in mm.
    plates : tuple of PlateauGaussian
        Additional thickness of the subchondral bone plate in each compartment and on the spines, in mm.
    canal_from_z_mm : float
        Height at which the medullary canal begins, in mm.
    canal_full_z_mm : float
        Height at which the canal has its full width, in mm.
    rim_mm : float
        Radius of the rounded rim of the plateau, in mm.
    far_rim_mm : float
        Radius of the anterior and posterior rim of the plateau, in mm.
    far_rim_y : float
        Distance from the middle along y at which the rim has the radius `far_rim_mm`, in mm.
    edge_mm : float
        Longest mesh edge, in mm.
    tolerance_mm : float
        Largest distance between the midpoint of a mesh edge and the bone surface, in mm; beyond this distance, the edge
        is split.
    bumps : tuple of Ellipsoid
        Ellipsoid of the tibial tuberosity.
    relief : tuple of PlateauGaussian
        Depressions, spines and other elevations of the plateau.
    roughness_zones : tuple of RoughnessZone
        Zones with a rough surface.
    """

    sections: Rows
    deeper_medially: float
    deeper_above_z: float
    shaft_pivot_z_mm: float
    cortex: Rows
    plate_mm: float
    plates: tuple[PlateauGaussian, ...]
    canal_from_z_mm: float
    canal_full_z_mm: float
    rim_mm: float
    far_rim_mm: float
    far_rim_y: float
    edge_mm: float
    tolerance_mm: float
    bumps: tuple[Ellipsoid, ...]
    relief: tuple[PlateauGaussian, ...]
    roughness_zones: tuple[RoughnessZone, ...]


class FibulaShape(Record, frozen=True):
    """Proximal fibula, in the frame of the tibia.

    Attributes
    ----------
    sections : rows of float
        Rows of height z, half ML width, half AP depth, centre y and centre x, in mm.
    cortex : rows of float
        Rows of height z and cortical thickness, in mm.
    gap_to_tibia_mm : float
        Width of the tibiofibular joint, in mm.
    joint_mm : (float, float, float)
        Position of the tibiofibular joint on the tibia, in mm.
    faces : (float, float, float)
        Normal vector of the fibular joint surface.
    """

    sections: Rows
    cortex: Rows
    gap_to_tibia_mm: float
    joint_mm: Triple
    faces: Triple


class PatellaShape(Record, frozen=True):
    """Shape of the patella.

    Attributes
    ----------
    sections : rows of float
        Cross-sections, with z measured from the middle of the patella, in mm.
    centre_mm : (float, float, float)
        Centre of the patella in the frame of the template femur, in mm.
    tendon_end_mm : float
        Height of the lower tendon end above the middle of the tendon attachment on the tuberosity, in mm.
    gap_to_femur_mm : float
        Distance between patella and femur, including the cartilage of both bones, in mm.
    cartilage_mm : float
        Thickness of the patellar cartilage, in mm.
    cartilage_from : float
        Relative height above which the posterior surface has cartilage, from 0 at the apex to 1 at the base.
    cortex : rows of float
        Rows of height z and cortical thickness, in mm.
    """

    sections: Rows
    centre_mm: Triple
    tendon_end_mm: float
    gap_to_femur_mm: float
    cartilage_mm: float
    cartilage_from: float
    cortex: Rows


class FabellaShape(Record, frozen=True):
    """Shape of the fabella.

    Attributes
    ----------
    x : float
        Mediolateral position of the fabella behind the lateral condyle, in mm.
    z : float
        Height of the fabella in the frame of the femur, in mm.
    reach_mm : float
        Half the side length of the square in the xz plane within which the posterior surface of the femur is searched
        for, in mm.
    behind_mm : float
        Distance of the fabella behind the femur, in mm.
    form : (float, float, float)
        Semi-axes in x, y and z, relative to half the height of the fabella.
    cortex_mm : float
        Cortical thickness, in mm.
    """

    x: float
    z: float
    reach_mm: float
    behind_mm: float
    form: Triple
    cortex_mm: float


class OsteophyteMargin(Record, frozen=True):
    """Joint margin of a bone, on which osteophytes grow.

    Each pair of distances is an offset in mm and a slope in mm per mm of osteophyte size.

    Attributes
    ----------
    band_z : (float, float)
        Height range in which the margin is searched for, in mm.
    at_z : float
        Approximate height of the margin, in mm.
    joint : {1.0, -1.0}
        Direction towards the joint along z: 1 is proximal, -1 distal.
    medial_drop_mm : (float, float)
        Distance of the joint-facing surface of a medial osteophyte from the joint surface: offset in mm and slope in mm
        per mm of osteophyte size.
    lateral_drop_mm : (float, float)
        Distance of the joint-facing surface of a lateral osteophyte from the joint surface: offset in mm and slope in
        mm per mm of osteophyte size.
    """

    band_z: Pair
    at_z: float
    joint: float
    medial_drop_mm: Pair
    lateral_drop_mm: Pair


class MarginalOsteophyteShape(Record, frozen=True):
    """Shape of marginal osteophytes. Each pair is an offset in mm and a slope in mm per mm of osteophyte size.

    Attributes
    ----------
    edge_mm : (float, float)
        Radius of the rounded edge: offset in mm and slope in mm per mm of osteophyte size.
    base_mm : (float, float)
        Height of the base: offset in mm and slope in mm per mm of osteophyte size.
    highest_mm : float
        Largest height of the base, in mm.
    long_mm : (float, float)
        Length along the margin: offset in mm and slope in mm per mm of osteophyte size.
    longest_mm : float
        Largest length along the margin, in mm.
    bulge : float
        Protrusion of the base without the rounded edge, as a fraction of the osteophyte size.
    turn_deg : float
        Angle between the direction of growth and the mediolateral axis at the anterior and posterior ends of the
        margin, in degrees.
    """

    edge_mm: Pair
    base_mm: Pair
    highest_mm: float
    long_mm: Pair
    longest_mm: float
    bulge: float
    turn_deg: float


class CentralOsteophyteShape(Record, frozen=True):
    """Position and shape of central osteophytes. Each pair of lengths is an offset in mm and a slope in mm per mm.

    Attributes
    ----------
    across_mm : float
        Distance from the middle of the knee to the middle of a compartment, in mm.
    base_half_width_mm : float
        Half width of the bone surface from which the osteophyte height is measured, in mm; in x on the femur, in x and
        y on the tibia.
    femur_deg : (float, float)
        Angles of the most anterior and the most posterior position on the femur, from distal (0) to posterior, in
        degrees.
    tibia_mm : (float, float)
        Most anterior and most posterior position on the tibia, measured from the middle of the knee, in mm.
    tibia_above_mm : float
        Height above which the surface of the tibia counts as joint surface, in mm.
    wide_mm : (float, float)
        Distance from the centre of the osteophyte to the spheres at its base: offset in mm and slope in mm per mm of
        size.
    foot_mm : (float, float)
        Radius of a sphere at the base: offset in mm and slope in mm per mm of size.
    sunk_mm : float
        Depth of the sphere centres at the base below the bone surface, in mm.
    tip_mm : (float, float)
        Radius of the rounded top: offset in mm and slope in mm per mm of size.
    top_share : float
        Width of the top relative to the width of the base (`wide_mm`).
    top_falls : float
        Height decrease from the centre to the edge of the top, as a fraction of the osteophyte size.
    """

    across_mm: float
    base_half_width_mm: float
    femur_deg: Pair
    tibia_mm: Pair
    tibia_above_mm: float
    wide_mm: Pair
    foot_mm: Pair
    sunk_mm: float
    tip_mm: Pair
    top_share: float
    top_falls: float


class OsteophyteShapes(Record, frozen=True):
    """Joint margins on which osteophytes grow, and shapes of osteophytes.

    Attributes
    ----------
    femur : OsteophyteMargin
        Margin of the femur.
    tibia : OsteophyteMargin
        Margin of the tibia.
    lip : MarginalOsteophyteShape
        Shape of marginal osteophytes.
    central : CentralOsteophyteShape
        Shape of central osteophytes.
    """

    femur: OsteophyteMargin
    tibia: OsteophyteMargin
    lip: MarginalOsteophyteShape
    central: CentralOsteophyteShape


class StatureBySex(Record, frozen=True):
    """Body height of men and of women.

    Attributes
    ----------
    male : float
        Mean body height of men, in mm.
    female : float
        Mean body height of women, in mm.
    """

    male: float
    female: float


class TemplateSize(Record, frozen=True):
    """Sizes that scale the template anatomy.

    Attributes
    ----------
    male_tibial_ml_mm : float
        ML width of the male tibial plateau, in mm.
    female_over_male : float
        Size of female bones relative to male bones.
    stature_mm : StatureBySex
        Mean body height of each sex, in mm.
    """

    male_tibial_ml_mm: float
    female_over_male: float
    stature_mm: StatureBySex


class TemplateAnatomy(Record, frozen=True):
    """Shape of the template anatomy.

    Attributes
    ----------
    size : TemplateSize
        Sizes that scale the bones.
    unevenness : CorticalThicknessVariation
        Random variation of the cortical thickness.
    notch_growth : NotchGrowthZones
        Growth of bone into the notch.
    femur : FemurShape
        Shape of the femur.
    tibia : TibiaShape
        Shape of the tibia.
    osteophytes : OsteophyteShapes
        Shape of the osteophytes.
    fibula : FibulaShape
        Shape of the fibula.
    patella : PatellaShape
        Shape of the patella.
    fabella : FabellaShape
        Shape of the fabella.
    cartilage : Cartilage
        Shape of the cartilage.
    menisci : Menisci
        Shape of the menisci.
    fat_pad : FatPad
        Shape of the infrapatellar fat pad.
    patellar_tendon : PatellarTendon
        Shape of the patellar tendon.
    quadriceps_tendon : QuadricepsTendon
        Shape of the quadriceps tendon.
    muscles : tuple of MuscleShape
        Shapes of the muscles, vessels and nerve.
    deep_fat : DeepFat
        Thickness of the tissue inside the fascia that is not fat.
    effusion : EffusionShape
        Shape of the swelling of the joint.
    soft : LimbShape
        Skin, subcutaneous fat and fascia.
    """

    size: TemplateSize
    unevenness: CorticalThicknessVariation
    notch_growth: NotchGrowthZones
    femur: FemurShape
    tibia: TibiaShape
    osteophytes: OsteophyteShapes
    fibula: FibulaShape
    patella: PatellaShape
    fabella: FabellaShape
    cartilage: Cartilage
    menisci: Menisci
    fat_pad: FatPad
    patellar_tendon: PatellarTendon
    quadriceps_tendon: QuadricepsTendon
    muscles: tuple[MuscleShape, ...]
    deep_fat: DeepFat
    effusion: EffusionShape
    soft: LimbShape


@cache
def load_template_anatomy() -> TemplateAnatomy:
    """Load the template anatomy.

    Returns
    -------
    TemplateAnatomy
        Content of ``data/anatomy.toml``.
    """
    return parse_record(TemplateAnatomy, load_data_table("anatomy"), "anatomy")
