"""Template anatomy: soft tissue around the bones of an average male right knee (``data/anatomy.toml``), in mm."""

from ..table_records import (
    Numbers,
    Pair,
    Record,
    Rows,
    Triple,
)


class FemoralCartilage(Record, frozen=True):
    """Bounds of the articular surface of the femur, in the frame of the femur, in mm.

    The surface has three parts. The distal part is below `below_z`. The posterior part is behind `behind_y` and below
    `behind_z`. The trochlea is in front of `before_y`, below `before_z` and within `before_x` of the middle. The notch
    is excluded.

    Attributes
    ----------
    below_z : float
        Upper bound of the distal part of the surface, in mm.
    behind_y, behind_z : float
        Anterior and upper bound of the posterior part of the surface, in mm.
    before_y, before_z, before_x : float
        Posterior, upper and mediolateral bound of the trochlea, in mm.
    notch_x, notch_y : float
        Half width and anterior bound of the notch, in mm.
    """

    below_z: float
    behind_y: float
    behind_z: float
    before_y: float
    before_z: float
    before_x: float
    notch_x: float
    notch_y: float


class PlateauEllipse(Record, frozen=True):
    """Ellipse on the tibial plateau.

    Attributes
    ----------
    x, y : float
        Centre, in mm.
    half_x, half_y : float
        Semi-axes, in mm.
    """

    x: float
    y: float
    half_x: float
    half_y: float


class Cartilage(Record, frozen=True):
    """Cartilage of femur and tibia.

    Attributes
    ----------
    share : float
        Cartilage thickness on each bone, as a fraction of the joint space.
    femur : FemoralCartilage
        Articular surface of the femur.
    tibia : tuple of PlateauEllipse
        Articular surfaces of the tibia.
    """

    share: float
    femur: FemoralCartilage
    tibia: tuple[PlateauEllipse, ...]


class Meniscus(Record, frozen=True):
    """Ring of a meniscus.

    Attributes
    ----------
    x, y : float
        Centre, in mm.
    outer : (float, float)
        Outer semi-axes in x and y, in mm.
    inner : (float, float)
        Inner semi-axes in x and y, in mm.
    """

    x: float
    y: float
    outer: Pair
    inner: Pair


class Menisci(Record, frozen=True):
    """Both menisci.

    Attributes
    ----------
    medial : Meniscus
        Shape of the medial meniscus.
    lateral : Meniscus
        Shape of the lateral meniscus.
    height_mm : (float, float)
        Heights of the lower and the upper end of the rings, in mm.
    gap_mm : float
        Width of the opening of a ring towards the middle of the knee, in mm.
    """

    medial: Meniscus
    lateral: Meniscus
    height_mm: Numbers
    gap_mm: float


class FatPad(Record, frozen=True):
    """Infrapatellar fat pad, in the frame of the tibia.

    Attributes
    ----------
    centre : (float, float, float)
        Centre, in mm.
    half : (float, float, float)
        Semi-axes, in mm.
    """

    centre: Triple
    half: Triple


class PatellarTendon(Record, frozen=True):
    """Shape of the patellar tendon.

    Attributes
    ----------
    from_apex : (float, float, float)
        Position of the upper end relative to the apex of the patella, in mm.
    tuberosity : (float, float, float)
        Position of the lower end in the frame of the tibia, in mm.
    half : (float, float, float)
        Semi-axes of the ends of the tendon, in mm.
    """

    from_apex: Triple
    tuberosity: Triple
    half: Triple


class QuadricepsTendon(Record, frozen=True):
    """Shape of the quadriceps tendon.

    Attributes
    ----------
    from_base : (float, float, float)
        Position of the lower end relative to the base of the patella, in mm.
    upwards : (float, float, float)
        Vector from the lower to the upper end, in the frame of the femur, in mm.
    half_below : (float, float, float)
        Semi-axes of the lower end, in mm.
    half_above : (float, float, float)
        Semi-axes of the upper end, in mm.
    """

    from_base: Triple
    upwards: Triple
    half_below: Triple
    half_above: Triple


class MuscleShape(Record, frozen=True):
    """Muscle, or bundle of vessels and nerve.

    Attributes
    ----------
    name : str
        Name of the muscle or bundle.
    sections : rows of float
        Rows of z (mm), then half ML width, half AP depth, centre y and centre x as fractions of the semi-axes of the
        fascia at this height.
    """

    name: str
    sections: Rows


class DeepFat(Record, frozen=True):
    """Thickness of the tissue inside the fascia that is not fat.

    Attributes
    ----------
    fascia_mm : float
        Thickness of the fascia, in mm.
    sheath_mm : float
        Thickness of the layer around tendons and the fat pad, in mm.
    cover : rows of float
        Rows of height z and thickness of the layer around the bones, in mm.
    """

    fascia_mm: float
    sheath_mm: float
    cover: Rows


class EffusionShape(Record, frozen=True):
    """Swelling of the joint, per mm of `Knee.effusion_mm`.

    Attributes
    ----------
    height_profile : rows of float
        Rows of height z (mm) and fraction of the maximum swelling.
    front_and_back : float
        Anterior and posterior displacement of the fascia, in mm per mm of effusion.
    medial : float
        Medial displacement of the fascia, in mm per mm of effusion.
    """

    height_profile: Rows
    front_and_back: float
    medial: float


class SkinFold(Record, frozen=True):
    """Skin fold: a furrow along part of the circumference of the limb.

    Attributes
    ----------
    z : float
        Height of the middle of the fold, in mm.
    towards_deg : float
        Direction of the middle of the fold in degrees: 0 medial, 90 posterior, 180 lateral, 270 anterior.
    half_turn_deg : float
        Angle from the middle of the fold to each end, in degrees.
    drop_mm : float
        Height of the middle of the fold above its ends, in mm.
    width_mm : float
        Width of the fold at the skin, in mm.
    share : float
        Depth of the fold relative to the deepest fold.
    """

    z: float
    towards_deg: float
    half_turn_deg: float
    drop_mm: float
    width_mm: float
    share: float


class LimbShape(Record, frozen=True):
    """Skin, subcutaneous fat and fascia.

    Attributes
    ----------
    sections : rows of float
        Rows of z (mm), additional half ML width compared with the width around the bones (mm), half AP depth relative
        to the half AP depth at the joint, and centre y (mm).
    capsule_mm : float
        Distance between bone and subcutaneous fat on the medial and the lateral side, in mm.
    skin_mm : float
        Thickness of the skin, in mm.
    anterior_fat_share : float
        Thickness of the anterior fat relative to the medial fat.
    folds : tuple of SkinFold
        Skin folds with their positions.
    """

    sections: Rows
    capsule_mm: float
    skin_mm: float
    anterior_fat_share: float
    folds: tuple[SkinFold, ...]
