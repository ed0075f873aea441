"""Trabecular bone: smooth density of each bone, and the lattice of its struts (``data/trabeculae.toml``).

Lengths are in mm and are scaled with the size of the bones, except those of the lattice. BV/TV is bone volume divided
by tissue volume.
"""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Pair,
    Record,
    Triple,
    parse_record,
)


class BoneMarrowMix(Record, frozen=True):
    """Mixture of bone and marrow at relative density 1.

    Attributes
    ----------
    bvtv : float
        BV/TV of the mixture.
    marrow : float
        Attenuation of marrow relative to the attenuation of the mixture.
    """

    bvtv: float
    marrow: float


class StrutLattice(Record, frozen=True):
    """Periodic block of struts: a Gaussian random field with a specified power spectrum and a threshold for bone.

    Attributes
    ----------
    voxel_mm : (float, float, float)
        Voxel size in x, z and y, in mm.
    voxels : (int, int, int)
        Number of voxels in x, z and y.
    stretch_y : float
        Factor by which the field is stretched along y.
    waves_y : int
        Number of frequencies along y.
    low_per_mm : float
        Spatial frequency below which the power is flat, in 1/mm.
    high_per_mm : float
        Spatial frequency above which the power decreases, in 1/mm.
    low_frequency_exponent : float
        Exponent of the power spectrum between `low_per_mm` and `high_per_mm`.
    high_frequency_exponent : float
        Exponent of the decrease of the power spectrum above `high_per_mm`.
    vertical_power : float
        Power of vertical struts.
    horizontal_power : float
        Power of horizontal struts.
    isotropic_power : float
        Power of struts without preferred direction.
    patches : (float, float)
        Fraction of the variance due to dense and sparse patches: median over knees, and SD of the logarithm of the
        fraction.
    patch_per_mm : float
        Bandwidth of the dense and sparse patches, in 1/mm.
    patch_aspect_ratio : float
        Height of a dense or sparse patch of struts, relative to the width of the patch.
    length_per_mm : float
        Bandwidth along a strut, 1 / (2 pi length), in 1/mm.
    angular_spread_rad : float
        Spread of the directions of struts, in radians.
    threshold_sd : float
        Threshold of the field above which a voxel is bone, in SD.
    softness : float
        Width of the transition at the threshold, in SD.
    """

    voxel_mm: Triple
    voxels: tuple[int, int, int]
    stretch_y: float
    waves_y: int
    low_per_mm: float
    high_per_mm: float
    low_frequency_exponent: float
    high_frequency_exponent: float
    vertical_power: float
    horizontal_power: float
    isotropic_power: float
    patches: Pair
    patch_per_mm: float
    patch_aspect_ratio: float
    length_per_mm: float
    angular_spread_rad: float
    threshold_sd: float
    softness: float


class Ageing(Record, frozen=True):
    """Decrease of BV/TV and increase of strut contrast with age.

    Attributes
    ----------
    reference_years : float
        Reference age of the other attributes, in years.
    per_year : float
        Relative decrease of BV/TV per year.
    mean : dict of str to float
        BV/TV of each sex at the reference age, relative to men.
    contrast_per_year : dict of str to float
        Relative increase of strut contrast per year, for each sex.
    """

    reference_years: float
    per_year: float
    mean: dict[str, float]
    contrast_per_year: dict[str, float]


class BoneDensityVariation(Record, frozen=True):
    """Variation of bone density between persons of the same age and sex.

    Attributes
    ----------
    density : (float, float)
        Mean and SD of `Knee.bone_density`.
    """

    density: Pair


class StrutCoarseness(Record, frozen=True):
    """Coarsening of struts with sclerosis and age.

    Attributes
    ----------
    per_plate : float
        Relative coarsening of struts per unit increase in relative subchondral plate thickness.
    per_year : dict of str to float
        Relative coarsening per year, for each sex.
    deviation : float
        SD of the logarithm of coarseness between persons.
    """

    per_plate: float
    per_year: dict[str, float]
    deviation: float


class Sclerosis(Record, frozen=True):
    """Increase of BV/TV with the thickness of the subchondral bone plate.

    Attributes
    ----------
    per_plate : float
        Relative BV/TV increase per unit increase in relative subchondral plate thickness.
    deep_mm : float
        Depth at which the BV/TV increase has fallen to a quarter, in mm.
    other_side : float
        Thickening of the subchondral bone plate in the other compartment, relative to the compartment that narrows.
    other_side_deep : float
        Increase of BV/TV in the other compartment, relative to the compartment that narrows.
    fills_per_plate : float
        Relative decrease of strut contrast per unit increase in relative subchondral plate thickness.
    """

    per_plate: float
    deep_mm: float
    other_side: float
    other_side_deep: float
    fills_per_plate: float


class MedialLateralTransition(Record, frozen=True):
    """Transition between the medial and the lateral side.

    Attributes
    ----------
    middle_mm : float
        Width of the transition, in mm.
    """

    middle_mm: float


class PhysealScar(Record, frozen=True):
    """Parameters of the physeal scar that are the same for all bones.

    Attributes
    ----------
    off_mm : (float, float)
        Range of the distance between the bone midline and the position of the strongest scar, in mm.
    wide_mm : float
        Distance over which the strength of the scar falls to a quarter, in mm.
    least : float
        Smallest scar strength on the medial or the lateral side, relative to the largest strength.
    dome_off_mm : float
        Largest anteroposterior distance between the apex of the domed scar and the centre of the bone, in mm.
    ripple_mm : float
        Amplitude of the undulation of the physeal scar, in mm.
    ripple_length_mm : float
        Wavelength of the undulation of the physeal scar, in mm.
    """

    off_mm: Pair
    wide_mm: float
    least: float
    dome_off_mm: float
    ripple_mm: float
    ripple_length_mm: float


class StrutWaviness(Record, frozen=True):
    """Lateral waviness of the struts.

    Attributes
    ----------
    amplitude_mm : float
        Amplitude of the waves, in mm.
    length_mm : float
        Wavelength of the waves along a strut, in mm.
    across : float
        Phase change per mm across struts, relative to the phase change along struts.
    """

    amplitude_mm: float
    length_mm: float
    across: float


class TrabecularDensityProfile(Record, frozen=True):
    """Smooth component of the trabecular density of one bone, without struts.

    Attributes
    ----------
    sclerosis : float
        Fraction of the full sclerosis that applies to this bone.
    shaft_direction : {1.0, -1.0}
        Direction of the shaft along z: 1 is proximal, -1 distal.
    bvtv : float
        BV/TV in the epiphysis.
    shaft : float
        BV/TV in the shaft, far from the joint.
    fade_mm : float
        Depth at which BV/TV is the mean of epiphysis and shaft, in mm.
    medial : float
        Relative increase of BV/TV towards the medial side.
    load : float
        Relative increase of BV/TV in the columns under the condyles, and decrease between the columns.
    column_mm : float
        Distance of the columns from the middle of the bone, in mm.
    column_half_mm : float
        Half width of the columns, in mm.
    margin_mm : float
        Distance from the middle of the bone beyond which BV/TV decreases, in mm.
    margin_half_mm : float
        Distance beyond `margin_mm` at which BV/TV has fallen to half, in mm.
    plate : float
        Relative increase of BV/TV at the subchondral bone plate.
    plate_mm : float
        Depth at which the increase at the plate has fallen to half, in mm.
    plate_struts : float
        Fraction of the increase at the plate that is due to thicker struts; the rest is a dense mesh.
    plate_medial : float
        Relative change of the increase at the plate towards the medial side.
    between : float
        Fraction of the increase at the plate that is missing between the compartments.
    between_mm : float
        Medial distance between the middle of the bone and the position with the missing increase, in mm.
    between_half_mm : float
        Distance from `between_mm` at which the deficit has fallen to a quarter, in mm.
    struts : float
        Relative increase of strut contrast at the joint surface.
    struts_half_mm : float
        Depth at which the increase of strut contrast has fallen to a quarter, in mm.
    strut_convergence : float
        Relative convergence of struts in the shaft, far from the joint.
    strut_convergence_mm : float
        Distance from the joint along the shaft at which the struts have completed half of their convergence, in mm.
    strut_flattening : float
        Factor by which horizontal struts are closer, and vertical struts farther apart, than in the lattice.
    joint : (float, float, float)
        Circle (y, z, radius) about an axis along x that approximates the joint surface, in mm.
    below : float
        Height, relative to the centre of the circle, above which the approximated joint surface is vertical, in mm.
    dips : three of (float, float, float)
        Deviations of the approximated joint surface from the circle along x: centre, half width and height, in mm.
    rim : float
        Fraction of the bone that is missing in the rim of the medial plateau.
    rim_from_mm : float
        Medial distance from the middle beyond which bone is missing, in mm.
    rim_mm : float
        Depth below the joint surface down to which bone is missing, in mm.
    rim_half_mm : float
        Half width of the transitions at `rim_from_mm` and `rim_mm`, in mm.
    gain : float
        Contrast of the struts; at 1 there is no bone between struts.
    gain_load : float
        Relative increase of strut contrast in the columns.
    gain_shaft : float
        Contrast of the struts in the shaft, far from the joint.
    scar_mm : (float, float)
        Height range of the physeal scar, in mm.
    scar_slope : float
        Slope of the scar in the medial direction.
    scar_bow_per_mm : float
        Mediolateral curvature of the scar, in 1/mm.
    scar_dome_per_mm : float
        Anteroposterior curvature of the scar, in 1/mm.
    scar_bvtv : float
        Additional BV/TV in the scar.
    scar_sides : (float, float)
        Largest fraction of `scar_bvtv` on the lateral and on the medial side.
    scar_half_mm : float
        Half thickness of the scar, in mm.
    """

    sclerosis: float
    shaft_direction: float
    bvtv: float
    shaft: float
    fade_mm: float
    medial: float
    load: float
    column_mm: float
    column_half_mm: float
    margin_mm: float
    margin_half_mm: float
    plate: float
    plate_mm: float
    plate_struts: float
    plate_medial: float
    between: float
    between_mm: float
    between_half_mm: float
    struts: float
    struts_half_mm: float
    strut_convergence: float
    strut_convergence_mm: float
    strut_flattening: float
    joint: Triple
    below: float
    dips: tuple[Triple, Triple, Triple]
    rim: float
    rim_from_mm: float
    rim_mm: float
    rim_half_mm: float
    gain: float
    gain_load: float
    gain_shaft: float
    scar_mm: Pair
    scar_slope: float
    scar_bow_per_mm: float
    scar_dome_per_mm: float
    scar_bvtv: float
    scar_sides: Pair
    scar_half_mm: float


class TrabecularBone(Record, frozen=True):
    """Trabecular bone parameters of all bones.

    Attributes
    ----------
    tissue : BoneMarrowMix
        Mixture of bone and marrow.
    lattice : StrutLattice
        Lattice of struts.
    ageing : Ageing
        Dependence of trabecular bone density and strut contrast on age.
    person : BoneDensityVariation
        Variation of bone density between persons.
    grain : StrutCoarseness
        Coarseness of struts.
    sclerosis : Sclerosis
        Dependence of trabecular bone density on the thickness of the subchondral bone plate.
    side : MedialLateralTransition
        Transition between the medial and the lateral side.
    scar : PhysealScar
        Parameters of the physeal scar.
    sway : StrutWaviness
        Waviness of struts.
    tibia : TrabecularDensityProfile
        Density of the tibia.
    femur : TrabecularDensityProfile
        Density of the femur.
    fibula : TrabecularDensityProfile
        Density of the fibula.
    patella : TrabecularDensityProfile
        Density of patella and fabella.
    """

    tissue: BoneMarrowMix
    lattice: StrutLattice
    ageing: Ageing
    person: BoneDensityVariation
    grain: StrutCoarseness
    sclerosis: Sclerosis
    side: MedialLateralTransition
    scar: PhysealScar
    sway: StrutWaviness
    tibia: TrabecularDensityProfile
    femur: TrabecularDensityProfile
    fibula: TrabecularDensityProfile
    patella: TrabecularDensityProfile


@cache
def load_trabecular_bone() -> TrabecularBone:
    """Load the tables of trabecular bone.

    Returns
    -------
    TrabecularBone
        Content of ``data/trabeculae.toml``.
    """
    return parse_record(TrabecularBone, load_data_table("trabeculae"), "trabeculae")
