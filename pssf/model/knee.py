"""Knee: the parameters of one knee."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any, cast

from ..core.checks import InputError, from_table, require, require_whole
from ..core.keywords import keywords
from ..data.fields import check_fields
from ..data.limbs import limbs
from ..data.shapes import Mode, shape_table
from .kellgren_lawrence import require_grade

# No score of a shape is farther from the mean.
MOST_SD = 3.0
# Osteophytes of one margin lie at least so far apart, in the measure of their places; nearer ones are one.
APART = 0.5
# No more cysts than that: people with more are rare, and an epiphysis has room for them.
MOST_CYSTS = 6
# Spaces of healthy people differ by as much (deviation of a compartment 0.7 to 1 mm).
_CLEARLY_MM = 1.0
# At margins and on spines; and in the middle of a joint surface.
BORDER_SITES = ("medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia", "medial_spine", "lateral_spine")
CENTRAL_SITES = ("medial_condyle", "lateral_condyle", "medial_plateau", "lateral_plateau")
SITES = BORDER_SITES + CENTRAL_SITES
BONE_OF = {"femur": "femur", "condyle": "femur", "tibia": "tibia", "plateau": "tibia", "spine": "tibia"}
# A central one is no taller (judgement).
_TALLEST_CENTRAL_MM = 5.0


def other_compartment(side: str) -> str:
    """medial of lateral, and lateral of medial"""
    return "lateral" if side == "medial" else "medial"


@keywords()
@dataclass(frozen=True, kw_only=True)
class Osteophyte:
    """A bony lip at a joint margin, a spike on a tibial spine, or a mound in the middle of a joint surface.

    size_mm    how far its farthest point stands out of the bare bone
    place      along the margin, or across the joint surface: -1 in front, +1 behind, 0 in its middle
    curve_deg  of the lip's edge towards the joint, or away from it where it is negative
    raises     InputError for an unknown site, a value out of range (`data/osteophyte_fields.toml`), a place or curve
               of what is on a spine, or a curve or height of a central one
    """

    site: str
    size_mm: float
    place: float = 0.0
    curve_deg: float = 0.0

    def __post_init__(self) -> None:
        check_fields("osteophyte", self)
        if self.site.endswith("_spine") and (self.place or self.curve_deg):
            raise InputError(
                f"osteophyte at {self.site}: place = {self.place:g}, curve_deg = {self.curve_deg:g} deg; allowed: 0, "
                "since it stands on the spine's top"
            )
        if self.central and (self.curve_deg or self.size_mm > self.tallest_mm):
            raise InputError(
                f"osteophyte at {self.site}: size_mm = {self.size_mm:g} mm, curve_deg = {self.curve_deg:g} deg; "
                f"allowed: 0.2 to {self.tallest_mm:g} mm and 0 deg in the middle of a joint surface"
            )

    @property
    def central(self) -> bool:
        """Whether it is in the middle of a joint surface."""
        return self.site in CENTRAL_SITES

    @property
    def tallest_mm(self) -> float:
        """How tall it may be beyond what any may be, which has no bound here."""
        return _TALLEST_CENTRAL_MM if self.central else float("inf")

    @property
    def bone(self) -> str:
        """Femur or tibia, on which it is."""
        return BONE_OF[self.site.split("_")[1]]


@keywords()
@dataclass(frozen=True, kw_only=True)
class Cyst:
    """A subchondral cyst: a ball as soft as marrow in a wall of compact bone, in spongy bone, by the plate.

    diameter_mm  of what is soft, its wall aside
    place        in its compartment: -1 in front, +1 behind, 0 in the middle
    outward      0 towards the notch, 1 towards the margin
    raises       InputError for an unknown site, or a value out of range (`data/cyst_fields.toml`)
    """

    site: str
    diameter_mm: float
    place: float = 0.0
    outward: float = 0.5

    def __post_init__(self) -> None:
        check_fields("cyst", self)


@keywords()
@dataclass(frozen=True, kw_only=True)
class Knee:
    """Parameters of one knee (defaults: a healthy average man, right side).

    jsw_*_mm           joint space of a compartment, scaled to the joint plane
    jsw_as             "projected": its smallest vertical gap between the projected cortical contours in the protocol
                       `reference`; "read": as readers take it, from the femur's contour to the line through the
                       tibia's contour landmarks, in `fixed_flexion`
    cysts              at most MOST_CYSTS
    subchondral_plate  thickness of the plate relative to a healthy one, of the `sclerotic_side`
    varus_deg          angle between femoral and tibial shaft beyond the normal valgus of 5 deg; positive is varus
    mechanical_axis_deg
                       of the femur, from its shaft towards the hip's centre. The hip is beyond the picture: of all
                       that a radiograph holds, only the label hip_knee_ankle_deg follows it
    notch_growth_mm    of bone into the notch: on its walls and roof, over the eminence and, less, the plateaus' floors
    effusion_mm        how much thicker than in health capsule, synovium and fluid are about the joint
    skin_folds         how deep furrows of the skin are at most, in shares of the fat beneath them; 0 is none
    subluxation_mm     of the tibia to lateral, as the femur stands on it; joint spaces stay what they are
    flexion_deg        of the femur about the medio-lateral axis
    rotation_deg       of the leg about its long axis; positive is internal
    bone_scale         size of the bones relative to the mean of sex and stature
    shape              scores of the bones' shape, in standard deviations of people's: one a mode of
                       `data/shapes.toml`, in its order; those left out are 0, the mean
    form_seed          of what modes are too coarse for: where spines and notch stand, how the lateral plateau curves
    cortex_scale       cortical thickness relative to the mean
    lean_deg           of the tibial shaft on the film; positive: the foot towards medial
    fibular_tip_mm     of the fibula below the middle of the plateau
    insall_salvati     length of the patellar tendon over that of the patella
    patellar_shift_mm  of the patella's middle from the femur's, laterally
    patellar_tilt_deg  of the patella about its long axis; positive: its lateral edge backwards
    fabella_mm         height of the fabella; 0 where there is none
    bmi                of the person, kg/m2; gives the next two where they are not given
    limb_ap_mm         antero-posterior thickness of the limb at the joint; None: as people of that BMI and sex have it
    fat_mm             subcutaneous fat, medial and lateral; None: likewise
    age_years          thins the trabeculae
    bone_density       of the spongy bone over the mean of that age and sex
    texture_seed       of the trabeculae, of how uneven the cortex is and of how rough the bone, which a knee changed in
                       another field keeps
    grade              KL grade that the knee was sampled for; None: `Truth.grade` is derived from the anatomy
    grade_table        table of grades that it was sampled from; None for a knee built by hand
    grade_read         KL grade that a reader gives, who may be off by one; None where no reader is sampled
    raises             InputError for a value out of range, two osteophytes or cysts at one place, or a grade that
                       contradicts the anatomy (`kellgren_lawrence.allowed_grades`)
    """

    side: str = "right"
    sex: str = "male"
    stature_mm: float = 1755.0
    jsw_medial_mm: float = 5.0
    jsw_lateral_mm: float = 5.0
    jsw_as: str = "projected"
    osteophytes: tuple[Osteophyte, ...] = ()
    subchondral_plate: float = 1.0
    varus_deg: float = 0.0
    flexion_deg: float = 0.0
    rotation_deg: float = 0.0
    bone_scale: float = 1.0
    shape: tuple[float, ...] = ()
    form_seed: int = 0
    cortex_scale: float = 1.0
    tibial_slope_deg: float = 5.0
    lean_deg: float = 3.0
    fibular_tip_mm: float = 12.0
    insall_salvati: float = 1.14
    patellar_shift_mm: float = 3.0
    patellar_tilt_deg: float = 3.0
    fabella_mm: float = 0.0
    bmi: float = 27.0
    # None until it is resolved at birth.
    limb_ap_mm: float = cast(float, None)
    fat_mm: float = cast(float, None)
    age_years: float = 55.0
    bone_density: float = 1.0
    texture_seed: int = 0
    grade: int | None = None
    grade_table: str | None = None
    grade_read: int | None = None
    cysts: tuple[Cyst, ...] = ()
    subluxation_mm: float = 0.0
    notch_growth_mm: float = 0.0
    effusion_mm: float = 0.0
    skin_folds: float = 0.0
    mechanical_axis_deg: float = 5.4

    def __post_init__(self) -> None:
        check_fields("knee", self)
        for name, law in limbs().limb.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, law.mean(self.bmi, self.sex))
        for name, kind in _SEVERAL.items():
            given = getattr(self, name)
            if not isinstance(given, tuple | list) or not all(isinstance(item, kind) for item in given):
                raise InputError(f"{name} = {given!r}; allowed: a tuple of {kind.__name__}")
            object.__setattr__(self, name, tuple(given))
            _require_apart(name, given)
        require_whole("number of cysts", len(self.cysts), 0, MOST_CYSTS, "")
        object.__setattr__(self, "shape", require_scores(self.shape, shape_table().modes))
        require_grade(self)

    @property
    def sclerotic_side(self) -> str:
        """The side whose plate is thicker: lateral where that space is clearly the narrower one, else medial."""
        return "lateral" if self.jsw_medial_mm - self.jsw_lateral_mm > _CLEARLY_MM else "medial"


# What a knee may have several of.
_SEVERAL: dict[str, type[Osteophyte] | type[Cyst]] = {"osteophytes": Osteophyte, "cysts": Cyst}


def _require_apart(name: str, items: Sequence[Osteophyte | Cyst]) -> None:
    ordered = sorted(items, key=lambda item: (item.site, item.place))
    for one, other in pairwise(ordered):
        if one.site == other.site and other.place - one.place < APART:
            raise InputError(
                f"{name} at {one.site}, places {one.place:g} and {other.place:g}; allowed: one a site, or several "
                f"at places {APART:g} apart"
            )


def require_scores(scores: Any, modes: Sequence[Mode]) -> tuple[float, ...]:
    """Scores of a shape as floats, without the zeros at its end.

    raises  InputError for what is no sequence of numbers, too many of them, or one out of range
    """
    scores = scores.tolist() if hasattr(scores, "tolist") else scores  # numpy's
    if not isinstance(scores, tuple | list) or len(scores) > len(modes):
        raise InputError(f"shape = {scores!r}; allowed: up to {len(modes)} numbers, one a mode")
    for mode, score in zip(modes, scores, strict=False):
        require(f"shape score {mode.name}", score, -MOST_SD, MOST_SD, "SD")
    kept = [float(score) for score in scores]
    while kept and kept[-1] == 0.0:
        kept.pop()
    return tuple(kept)


def knee_from(table: Mapping[str, Any], what: str = "knee") -> Knee:
    """A knee from a mapping of its fields, as TOML or JSON gives it; `what` names the origin in a refusal."""
    table = dict(table)
    for name, kind in _SEVERAL.items():
        items, size = table.get(name, ()), fields(kind)[1].name
        if not isinstance(items, list | tuple) or not all(isinstance(item, Mapping) for item in items):
            raise InputError(f"{what}: {name} = {items!r}; allowed: a list of tables with site and {size}")
        one = kind.__name__.lower()
        table[name] = tuple(from_table(cast(Any, kind), item, f"{what}: {one}") for item in items)
    return from_table(Knee, table, what)


def knee_table(knee: Knee) -> dict[str, Any]:
    """Field name -> value of a knee, as `knee_from` takes it back (JSON-ready)."""
    return {
        **asdict(knee),
        "shape": list(knee.shape),
        **{name: [asdict(item) for item in getattr(knee, name)] for name in _SEVERAL},
    }
