"""What lies about the bones of the mean man's right knee, as `data/anatomy.toml` has it."""

from .records import Numbers, Pair, Record, Rows, Triple


class FemoralCartilage(Record, frozen=True):
    """Bounds of the articular surface."""

    below_z: float
    behind_y: float
    behind_z: float
    before_y: float
    before_z: float
    before_x: float
    notch_x: float
    notch_y: float


class Oval(Record, frozen=True):
    """An ellipse on the plateau."""

    x: float
    y: float
    half_x: float
    half_y: float


class Cartilage(Record, frozen=True):
    """Share of the joint space on each bone, and where on them."""

    share: float
    femur: FemoralCartilage
    tibia: tuple[Oval, ...]


class Meniscus(Record, frozen=True):
    """Outer and inner half axes of a ring."""

    x: float
    y: float
    outer: Pair
    inner: Pair


class Menisci(Record, frozen=True):
    """Both rings, the heights between which they stand, and the gap by which they are open."""

    medial: Meniscus
    lateral: Meniscus
    height_mm: Numbers
    gap_mm: float


class FatPad(Record, frozen=True):
    """The infrapatellar fat pad, in the tibia's frame."""

    centre: Triple
    half: Triple


class PatellarTendon(Record, frozen=True):
    """Its start from the patella's apex, its end in the tibia's frame, its section's half axes."""

    from_apex: Triple
    tuberosity: Triple
    half: Triple


class QuadricepsTendon(Record, frozen=True):
    """Its start from the patella's base and the way up from there, in the femur's frame; half axes at both ends."""

    from_base: Triple
    upwards: Triple
    half_below: Triple
    half_above: Triple


class MuscleShape(Record, frozen=True):
    """A muscle. sections: z; half ML, half AP, centre y and centre x in shares of the fascia's half axes there."""

    name: str
    sections: Rows


class DeepFat(Record, frozen=True):
    """What fat within the fascia keeps off: the fascia's own thickness, what covers tendons, and bones by height."""

    fascia_mm: float
    sheath_mm: float
    cover: Rows


class Effusion(Record, frozen=True):
    """Where the joint swells, and how far the fascia gives way to front and back and to medial, a millimetre of it.

    about  rows of z and share
    """

    about: Rows
    front_and_back: float
    medial: float


class SkinFold(Record, frozen=True):
    """A furrow along part of the limb's turn.

    z              of its middle, mm
    towards_deg    of its middle about the limb: 0 medial, 90 behind, 180 lateral, 270 in front
    half_turn_deg  from its middle to where it ends
    drop_mm        of its ends below its middle
    width_mm       of the furrow at the skin
    share          of the deepest furrow's depth
    """

    z: float
    towards_deg: float
    half_turn_deg: float
    drop_mm: float
    width_mm: float
    share: float


class Limb(Record, frozen=True):
    """Skin, fat and fascia. sections: z, half ML beyond the bone-related width, half AP over that at the joint, y."""

    sections: Rows
    capsule_mm: float
    skin_mm: float
    anterior_fat_share: float
    folds: tuple[SkinFold, ...]
