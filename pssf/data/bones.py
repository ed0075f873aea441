"""BoneShape and its like: the mean man's right knee as `data/anatomy.toml` has it; mm, degrees.

Sections are rows of height, half ML, half AP, centre y, centre x; cortex is rows of height and thickness.
"""

from functools import cache
from typing import Literal

from .records import Pair, Record, Rows, Triple, record
from .soft import Cartilage, DeepFat, Effusion, FatPad, Limb, Menisci, MuscleShape, PatellarTendon, QuadricepsTendon
from .tables import data


class Ellipsoid(Record, frozen=True):
    """A part that is blended into a bone, or carved out of it: its centre, half axes and fillet."""

    centre: Triple
    half: Triple
    fillet_mm: float


class Notch(Record, frozen=True):
    """The intercondylar notch. sections: y, height of the roof, curvature of its arch (1/mm), half width."""

    fillet_mm: float
    cortex_mm: float
    sections: Rows
    flare: float


class Condyle(Record, frozen=True):
    """Centre, lowest height, half extents, powers of the coronal outline (2 an ellipse, more is squarer), and
    how much it rises from its middle outwards, mm a mm."""

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
    """Both condyles of the femur."""

    medial: Condyle
    lateral: Condyle


class RoughZone(Record, frozen=True):
    """Where a bone is rough: an ellipsoid, the way in which places are moved, by how much, lengths of the waves, and
    whether that is of the bone's form or of its texture, each of which has a seed.
    """

    centre: Triple
    half: Triple
    way: Triple
    sd_mm: float
    lengths_mm: Pair
    of: Literal["texture", "form"]


class GrowthZone(Record, frozen=True):
    """Where bone grows: an ellipsoid, and how places in its middle are moved, mm a millimetre of growth."""

    centre: Triple
    half: Triple
    way: Triple


class NotchGrowth(Record, frozen=True):
    """What closes the notch: bone on its walls and roof, and over the eminence and the plateaus below."""

    femur: tuple[GrowthZone, ...]
    tibia: tuple[GrowthZone, ...]


class FemurShape(Record, frozen=True):
    """Distal femur; z = 0 at the condyles' distal end."""

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
    notch: Notch
    condyles: Condyles
    rough: tuple[RoughZone, ...]


class Unevenness(Record, frozen=True):
    """How uneven a cortex is: standard deviation of its thickness over the mean where that is `thin_mm` or less."""

    sd: float
    thin_mm: float
    least_mm: float
    shortest_mm: float
    longest_mm: float


class Bell(Record, frozen=True):
    """A rise of the plateau, or with a negative height a dish: a Gaussian of half widths."""

    x: float
    y: float
    height: float
    half_x: float
    half_y: float


class TibiaShape(Record, frozen=True):
    """Proximal tibia; z = 0 at the middle of the plateau."""

    sections: Rows
    deeper_medially: float
    deeper_above_z: float
    shaft_pivot_z_mm: float
    cortex: Rows
    plate_mm: float
    plates: tuple[Bell, ...]
    canal_from_z_mm: float
    canal_full_z_mm: float
    rim_mm: float
    far_rim_mm: float
    far_rim_y: float
    edge_mm: float
    tolerance_mm: float
    bumps: tuple[Ellipsoid, ...]
    relief: tuple[Bell, ...]
    rough: tuple[RoughZone, ...]


class FibulaShape(Record, frozen=True):
    """Proximal fibula, in the tibia's frame."""

    sections: Rows
    cortex: Rows
    gap_to_tibia_mm: float
    joint_mm: Triple
    faces: Triple


class PatellaShape(Record, frozen=True):
    """Patella; sections about its middle, which lies at `centre_mm` in the frame of the mean man's femur."""

    sections: Rows
    centre_mm: Triple
    tendon_end_mm: float
    gap_to_femur_mm: float
    cartilage_mm: float
    cartilage_from: float
    cortex: Rows


class FabellaShape(Record, frozen=True):
    """Fabella: where behind the femur it is looked for, how far behind it lies, half axes over half its size."""

    x: float
    z: float
    reach_mm: float
    behind_mm: float
    form: Triple
    cortex_mm: float


class Margin(Record, frozen=True):
    """Where a bone's margin is looked for, about how high it is, and the way to the joint (+1 up, -1 down).

    medial_drop_mm, lateral_drop_mm  how far the joint surface is above what of an osteophyte is nearest to it: of the
                                     smallest, and more of it a millimetre of size
    """

    band_z: Pair
    at_z: float
    joint: float
    medial_drop_mm: Pair
    lateral_drop_mm: Pair


class LipShape(Record, frozen=True):
    """Form of an osteophyte at a margin; pairs: of the smallest, and more of it a millimetre of size.

    edge_mm    radius of its edge
    base_mm    height of its base, and what it is at most
    long_mm    length along the margin, and what it is at most
    bulge      how far its base alone stands out, in shares of its size
    turn_deg   of the way outwards from sideways, at the front and back ends of the margin
    """

    edge_mm: Pair
    base_mm: Pair
    highest_mm: float
    long_mm: Pair
    longest_mm: float
    bulge: float
    turn_deg: float


class CentralShape(Record, frozen=True):
    """Where on a joint surface a central osteophyte may be, and its form; pairs of mm: at first, and more a mm of size.

    across_mm       from the middle of the knee to the middle of a compartment
    about_mm        bone so near in x, on the tibia in y too, is what it stands out of
    femur_deg       from straight down, backwards: at the front and back ends of its places
    tibia_mm        behind the knee's middle, likewise
    tibia_above_mm  what of the tibia may be joint surface
    wide_mm         from its middle to its feet
    foot_mm         radius of a foot, which lies `sunk_mm` within the bone
    tip_mm          radius of its top's rounding
    top_share       how wide its top is, over `wide_mm`; `top_falls`: by how much of its size it is lower there
    """

    across_mm: float
    about_mm: float
    femur_deg: Pair
    tibia_mm: Pair
    tibia_above_mm: float
    wide_mm: Pair
    foot_mm: Pair
    sunk_mm: float
    tip_mm: Pair
    top_share: float
    top_falls: float


class Margins(Record, frozen=True):
    """Of the bones that bear osteophytes, and the form of these."""

    femur: Margin
    tibia: Margin
    lip: LipShape
    central: CentralShape


class ByStature(Record, frozen=True):
    """A length of men and of women."""

    male: float
    female: float


class Size(Record, frozen=True):
    """What scales the bones."""

    male_tibial_ml_mm: float
    female_over_male: float
    stature_mm: ByStature


class BoneShape(Record, frozen=True):
    """All of `data/anatomy.toml`."""

    size: Size
    unevenness: Unevenness
    notch_growth: NotchGrowth
    femur: FemurShape
    tibia: TibiaShape
    osteophytes: Margins
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
    effusion: Effusion
    soft: Limb


@cache
def mean_shape() -> BoneShape:
    """The mean man's right knee."""
    return record(BoneShape, data("anatomy"), "anatomy")
