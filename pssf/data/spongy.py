"""Trabecular bone: how much there is where, and the lattice of its struts, as `data/trabeculae.toml` has them."""

from functools import cache

from .records import Pair, Record, Triple, record
from .tables import data


class Mix(Record, frozen=True):
    """Bone volume over tissue volume at relative density 1, and marrow's attenuation over that of the mix."""

    bvtv: float
    marrow: float


class Lattice(Record, frozen=True):
    """A periodic block (x, z, y), the spectrum of the field that it is cut from, and the cut."""

    voxel_mm: Triple
    voxels: tuple[int, int, int]
    stretch_y: float
    waves_y: int
    low_per_mm: float
    high_per_mm: float
    rise: float
    steep: float
    upright: float
    level: float
    any: float
    patches: Pair
    patch_per_mm: float
    patch_tall: float
    length_per_mm: float
    spread: float
    cut: float
    softness: float


class Ageing(Record, frozen=True):
    """Fall of BV/TV and rise of contrast a year, by sex."""

    reference_years: float
    per_year: float
    mean: dict[str, float]
    contrast_per_year: dict[str, float]


class Person(Record, frozen=True):
    """How people of one age and sex differ: mean and deviation of `Knee.bone_density`."""

    density: Pair


class Grain(Record, frozen=True):
    """How much coarser struts are, over the plate and a year by sex, and how people differ."""

    per_plate: float
    per_year: dict[str, float]
    deviation: float


class Sclerosis(Record, frozen=True):
    """Rise of BV/TV with the subchondral plate; what share of either is of the side that is less sclerotic."""

    per_plate: float
    deep_mm: float
    other_side: float
    other_side_deep: float
    fills_per_plate: float


class Side(Record, frozen=True):
    """Width over which medial and lateral pass into each other."""

    middle_mm: float


class Scar(Record, frozen=True):
    """Where the physeal scar may be strongest, how it falls from there, and how the sheet is bent."""

    off_mm: Pair
    wide_mm: float
    least: float
    dome_off_mm: float
    ripple_mm: float
    ripple_length_mm: float


class Sway(Record, frozen=True):
    """How far struts wave from side to side, over what length, and how much of that changes across."""

    aside_mm: float
    length_mm: float
    across: float


class SpongyBone(Record, frozen=True):
    """The smooth part of one bone's density; what each is, in the table."""

    sclerosis: float
    shaftward: float
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
    fan: float
    fan_mm: float
    squat: float
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
    """All of `data/trabeculae.toml`."""

    tissue: Mix
    lattice: Lattice
    ageing: Ageing
    person: Person
    grain: Grain
    sclerosis: Sclerosis
    side: Side
    scar: Scar
    sway: Sway
    tibia: SpongyBone
    femur: SpongyBone
    fibula: SpongyBone
    patella: SpongyBone


@cache
def trabecular_bone() -> TrabecularBone:
    """The package's table."""
    return record(TrabecularBone, data("trabeculae"), "trabeculae")
