"""Parameters of one knee with its osteophytes and cysts, checked when they are constructed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any, cast

from ..core.checks import (
    InputError,
    build_from_table,
    require_in_range,
    require_integer,
)
from ..core.keyword_arguments import check_keywords, renamed_attribute, update_field_names
from ..data.anatomy.limb_table import load_limb_statistics
from ..data.anatomy.shape_table import ShapeMode, load_shape_model
from ..data.knees.field_definitions import check_fields
from .kellgren_lawrence import require_grade

# Largest absolute score of a shape mode, in standard deviations from the population mean.
MAX_SHAPE_SD = 3.0
# Smallest distance between two osteophytes or cysts of one site, in units of `place`; nearer ones would merge.
MIN_POSITION_SPACING = 0.5
# Maximum number of cysts: patients with more are rare, and an epiphysis has space for this many.
MAX_CYSTS = 6
# The joint spaces of healthy subjects differ by this much, in mm (SD of one compartment 0.7 to 1 mm).
_CLEAR_DIFFERENCE_MM = 1.0
# Sites of osteophytes at the joint margins and on the tibial spines.
MARGIN_AND_SPINE_SITES = (
    "medial_femur",
    "lateral_femur",
    "medial_tibia",
    "lateral_tibia",
    "medial_spine",
    "lateral_spine",
)
# Sites of osteophytes in the middle of a joint surface.
CENTRAL_SITES = ("medial_condyle", "lateral_condyle", "medial_plateau", "lateral_plateau")
# All sites of osteophytes.
OSTEOPHYTE_SITES = MARGIN_AND_SPINE_SITES + CENTRAL_SITES
# Second word of a site -> bone.
BONE_OF_SITE_PART = {"femur": "femur", "condyle": "femur", "tibia": "tibia", "plateau": "tibia", "spine": "tibia"}
# Largest size of a central osteophyte, in mm (assumed).
_MAX_CENTRAL_SIZE_MM = 5.0


def other_compartment(side: str) -> str:
    """Return the opposite compartment.

    Parameters
    ----------
    side : {"medial", "lateral"}
        A compartment.

    Returns
    -------
    str
        "lateral" for "medial", and "medial" for "lateral".
    """
    return "lateral" if side == "medial" else "medial"


@check_keywords()
@dataclass(frozen=True, kw_only=True)
class Osteophyte:
    """Osteophyte at a joint margin, on a tibial spine, or in the middle of a joint surface.

    Parameters
    ----------
    site : str
        Location: a margin (``medial_femur``, ``lateral_femur``, ``medial_tibia``, ``lateral_tibia``), a tibial spine
        (``medial_spine``, ``lateral_spine``) or a joint surface (``medial_condyle``, ``lateral_condyle``,
        ``medial_plateau``, ``lateral_plateau``).
    size_mm : float
        Height of its farthest point above the bone without osteophytes, 0.2 to 10 mm; at most 5 mm on a joint surface.
    place : float, default 0
        Position along the margin or across the joint surface: -1 is anterior, 1 posterior. At a margin, 0 is where the
        bone extends farthest to the side. Must be 0 on a spine.
    curve_deg : float, default 0
        Curvature of its edge towards the joint, -45 to 45 degrees; negative away from the joint. Must be 0 on a spine
        and on a joint surface.

    Raises
    ------
    InputError
        If the site is unknown, a value is out of range (``data/osteophyte_fields.toml``), or `place`, `curve_deg` or
        `size_mm` is not allowed at the site.

    Examples
    --------
    >>> import pssf
    >>> osteophyte = pssf.Osteophyte(site="medial_tibia", size_mm=2.0)
    >>> osteophyte.bone, osteophyte.is_central
    ('tibia', False)
    """

    site: str
    size_mm: float
    place: float = 0.0
    curve_deg: float = 0.0

    # Earlier names, for one version.
    central = renamed_attribute("is_central")
    tallest_mm = renamed_attribute("max_size_mm")

    def __post_init__(self) -> None:
        check_fields("osteophyte", self)
        if self.site.endswith("_spine") and (self.place or self.curve_deg):
            raise InputError(
                f"osteophyte at {self.site}: place and curve_deg must be 0 on a tibial spine, got place = "
                f"{self.place:g} and curve_deg = {self.curve_deg:g} deg"
            )
        if self.is_central and (self.curve_deg or self.size_mm > self.max_size_mm):
            raise InputError(
                f"osteophyte at {self.site}: size_mm must be between 0.2 and {self.max_size_mm:g} mm and curve_deg 0 "
                f"on a joint surface, got size_mm = {self.size_mm:g} mm and curve_deg = {self.curve_deg:g} deg"
            )

    @property
    def is_central(self) -> bool:
        """True if the osteophyte is in the middle of a joint surface."""
        return self.site in CENTRAL_SITES

    @property
    def max_size_mm(self) -> float:
        """Largest size that the site allows, in mm; infinite where only the general range applies."""
        return _MAX_CENTRAL_SIZE_MM if self.is_central else float("inf")

    @property
    def bone(self) -> str:
        """Bone that carries the osteophyte, "femur" or "tibia"."""
        return BONE_OF_SITE_PART[self.site.split("_")[1]]


@check_keywords()
@dataclass(frozen=True, kw_only=True)
class Cyst:
    """Subchondral cyst: a sphere of marrow density in a wall of compact bone, in the trabecular bone under the plate.

    Parameters
    ----------
    site : {"medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia"}
        Bone and compartment.
    diameter_mm : float
        Diameter of the soft interior without its wall, 1.5 to 15 mm.
    place : float, default 0
        Position in the compartment from front to back: -1 is anterior, 0 the middle, 1 posterior.
    outward : float, default 0.5
        Position across the compartment: 0 is towards the notch, 1 towards the margin.

    Raises
    ------
    InputError
        If the site is unknown or a value is out of range (``data/cyst_fields.toml``).

    Examples
    --------
    >>> import pssf
    >>> pssf.Cyst(site="medial_tibia", diameter_mm=4.0)
    Cyst(site='medial_tibia', diameter_mm=4.0, place=0.0, outward=0.5)
    """

    site: str
    diameter_mm: float
    place: float = 0.0
    outward: float = 0.5

    def __post_init__(self) -> None:
        check_fields("cyst", self)


# Earlier name -> current name of a field.
RENAMED_FIELDS = {"jsw_as": "jsw_definition", "grade_read": "reader_grade"}


@check_keywords(**RENAMED_FIELDS)
@dataclass(frozen=True, kw_only=True)
class Knee:
    """Parameters of one knee; the defaults describe a healthy right knee of a man of mean stature.

    Parameters
    ----------
    side : {"right", "left"}, default "right"
        Side of the body. A left knee is the mirror image of a right one in x.
    sex : {"male", "female"}, default "male"
        Sex, which selects the mean sizes.
    stature_mm : float, default 1755
        Stature of the person, 1400 to 2100 mm; it scales the bones.
    jsw_medial_mm : float, default 5
        Medial joint space width, 0 to 10 mm, measured as `jsw_definition` says.
    jsw_lateral_mm : float, default 5
        Lateral joint space width, 0 to 10 mm, measured as `jsw_definition` says.
    jsw_definition : {"projected", "read"}, default "projected"
        Definition of both joint space widths. "projected" is the smallest vertical gap between the projected cortical
        contours under the protocol ``reference``. "read" is the gap that readers measure, under ``fixed_flexion``: from
        the contour of the femur to the line through the contour landmarks of the tibia. Medially this line follows the
        floor of the plateau.
    osteophytes : tuple of Osteophyte, default ()
        Osteophytes; two of one site must be at least 0.5 apart in `Osteophyte.place`.
    subchondral_plate : float, default 1
        Thickness of the subchondral bone plate relative to a healthy one, 0.5 to 2.5, on the `sclerotic_side`.
    varus_deg : float, default 0
        Angle between the shafts of femur and tibia beyond the normal valgus of 5 degrees, -16 to 16; positive is varus.
    flexion_deg : float, default 0
        Flexion of the femur about the medio-lateral axis, 0 to 15 degrees.
    rotation_deg : float, default 0
        Rotation of the leg about its long axis, -10 to 10 degrees; positive is internal.
    bone_scale : float, default 1
        Size of the bones relative to the mean of sex and stature, 0.85 to 1.15.
    shape : tuple of float, default ()
        Scores of the modes of bone shape (``data/shapes.toml``), each -3 to 3 standard deviations from the population
        mean. Scores that are left out are 0.
    form_seed : int, default 0
        Seed, 0 to 2**63 - 1, of details finer than the modes of shape: position of spines and notch, curvature of the
        lateral plateau, position of skin folds.
    cortex_scale : float, default 1
        Cortical thickness relative to the mean, 0.6 to 1.5.
    tibial_slope_deg : float, default 5
        Posterior slope of the tibial plateau, -2 to 18 degrees.
    lean_deg : float, default 3
        Lean of the tibial shaft from upright on the radiograph, -15 to 15 degrees; positive moves the foot medially.
    fibular_tip_mm : float, default 12
        Distance of the tip of the fibula below the middle of the plateau, 4 to 28 mm.
    insall_salvati : float, default 1.14
        Insall-Salvati ratio, length of the patellar tendon over length of the patella, 0.6 to 1.8.
    patellar_shift_mm : float, default 3
        Lateral distance of the middle of the patella from the middle of the femur, -10 to 15 mm.
    patellar_tilt_deg : float, default 3
        Rotation of the patella about its long axis, -15 to 20 degrees; positive moves its lateral edge backwards.
    fabella_mm : float, default 0
        Height of the fabella, 0 to 15 mm; 0 means no fabella.
    bmi : float, default 27
        Body mass index of the person, 15 to 50 kg/m2; it sets `limb_ap_mm` and `fat_mm` where they are None.
    limb_ap_mm : float, optional
        Antero-posterior thickness of the limb at the joint, 90 to 180 mm. None: the mean at this BMI and sex.
    fat_mm : float, optional
        Thickness of the subcutaneous fat on the medial and the lateral side, 2 to 40 mm. None: the mean at this BMI and
        sex.
    age_years : float, default 55
        Age, 18 to 100 years; the trabeculae become thinner with age.
    bone_density : float, default 1
        Density of the trabecular bone relative to the mean of age and sex, 0.4 to 1.8.
    texture_seed : int, default 0
        Seed, 0 to 2**63 - 1, of the trabeculae, the unevenness of the cortex and the roughness of the bone. They stay
        the same when other fields change.
    grade : int, optional
        KL grade, 0 to 4, that the knee was sampled for. None: `Truth.grade` is derived from the anatomy.
    grade_table : str, optional
        Grade table that the knee was sampled from, 1 to 255 characters. None: the knee was specified by its fields.
    reader_grade : int, optional
        KL grade, 0 to 4, that a simulated reader gives, which may differ by one grade. None: no reader is simulated.
    cysts : tuple of Cyst, default ()
        Subchondral cysts, at most 6; two of one site must be at least 0.5 apart in `Cyst.place`.
    subluxation_mm : float, default 0
        Displacement of the tibia relative to the femur, -6 to 6 mm; positive is lateral. Joint space widths do not
        change.
    notch_growth_mm : float, default 0
        Bone growth into the intercondylar notch, 0 to 3 mm: on its walls and roof, over the eminence and, less, on the
        floors of the plateaus.
    effusion_mm : float, default 0
        Additional thickness of capsule, synovium and joint fluid compared with a healthy joint, 0 to 10 mm.
    skin_folds : float, default 0
        Greatest depth of skin folds as a fraction of the thickness of the fat below them, 0 to 0.85; 0 means no folds.
    mechanical_axis_deg : float, default 5.4
        Angle from the shaft of the femur to its mechanical axis, which ends at the centre of the hip, 1 to 9 degrees.
        The hip is outside the image: only the label ``hip_knee_ankle_deg`` depends on it.

    Raises
    ------
    InputError
        If a value is out of range (``data/knee_fields.toml``), two osteophytes or cysts of one site are too near each
        other, or `grade` contradicts the anatomy (`kellgren_lawrence.allowed_grades`).

    Examples
    --------
    >>> import pssf
    >>> osteophyte = pssf.Osteophyte(site="medial_tibia", size_mm=2.0)
    >>> knee = pssf.Knee(side="left", jsw_medial_mm=3.1, osteophytes=(osteophyte,))
    >>> knee.side, knee.jsw_medial_mm, knee.limb_ap_mm
    ('left', 3.1, 119.6)
    """

    side: str = "right"
    sex: str = "male"
    stature_mm: float = 1755.0
    jsw_medial_mm: float = 5.0
    jsw_lateral_mm: float = 5.0
    jsw_definition: str = "projected"
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
    # None is replaced by the mean at this BMI and sex when the knee is constructed.
    limb_ap_mm: float = cast(float, None)
    fat_mm: float = cast(float, None)
    age_years: float = 55.0
    bone_density: float = 1.0
    texture_seed: int = 0
    grade: int | None = None
    grade_table: str | None = None
    reader_grade: int | None = None
    cysts: tuple[Cyst, ...] = ()
    subluxation_mm: float = 0.0
    notch_growth_mm: float = 0.0
    effusion_mm: float = 0.0
    skin_folds: float = 0.0
    mechanical_axis_deg: float = 5.4

    # Earlier names, for one version.
    jsw_as = renamed_attribute("jsw_definition")
    grade_read = renamed_attribute("reader_grade")

    def __post_init__(self) -> None:
        check_fields("knee", self)
        for name, law in load_limb_statistics().limb.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, law.mean_at_bmi(self.bmi, self.sex))
        for name, kind in _LIST_FIELDS.items():
            given = getattr(self, name)
            if not isinstance(given, tuple | list) or not all(isinstance(item, kind) for item in given):
                raise InputError(f"{name} must be a tuple of {kind.__name__}, got {given!r}")
            object.__setattr__(self, name, tuple(given))
            _require_spacing(name, given)
        require_integer("number of cysts", len(self.cysts), 0, MAX_CYSTS, "")
        object.__setattr__(self, "shape", require_shape_scores(self.shape, load_shape_model().modes))
        require_grade(self)

    @property
    def sclerotic_side(self) -> str:
        """Side with the thicker subchondral bone plate: "lateral" if clearly narrower there, else "medial"."""
        return "lateral" if self.jsw_medial_mm - self.jsw_lateral_mm > _CLEAR_DIFFERENCE_MM else "medial"


# Fields that hold a tuple of parameters -> dataclass of one entry.
_LIST_FIELDS: dict[str, type[Osteophyte] | type[Cyst]] = {"osteophytes": Osteophyte, "cysts": Cyst}


def _require_spacing(name: str, items: Sequence[Osteophyte | Cyst]) -> None:
    """Check that osteophytes or cysts of one site are far enough apart."""
    ordered = sorted(items, key=lambda item: (item.site, item.place))
    for one, other in pairwise(ordered):
        if one.site == other.site and other.place - one.place < MIN_POSITION_SPACING:
            raise InputError(
                f"{name} at {one.site} must be at least {MIN_POSITION_SPACING:g} apart in place, got places "
                f"{one.place:g} and {other.place:g}"
            )


def require_shape_scores(scores: Any, modes: Sequence[ShapeMode]) -> tuple[float, ...]:
    """Check the scores of a shape and return them without the zeros at the end.

    Parameters
    ----------
    scores : sequence of float
        One score per mode of shape, in standard deviations; later modes may be left out.
    modes : sequence of ShapeMode
        Modes of the shape model.

    Returns
    -------
    tuple of float
        Scores in standard deviations, without trailing zeros.

    Raises
    ------
    InputError
        If `scores` is no sequence, is longer than `modes`, or holds a value beyond 3 standard deviations or no number.
    """
    scores = scores.tolist() if hasattr(scores, "tolist") else scores  # A numpy array becomes a list.
    if not isinstance(scores, tuple | list) or len(scores) > len(modes):
        raise InputError(f"shape must be a sequence of up to {len(modes)} numbers, one per mode, got {scores!r}")
    for mode, score in zip(modes, scores, strict=False):
        require_in_range(f"shape score {mode.name}", score, -MAX_SHAPE_SD, MAX_SHAPE_SD, "SD")
    kept = [float(score) for score in scores]
    while kept and kept[-1] == 0.0:
        kept.pop()
    return tuple(kept)


def knee_from_dict(table: Mapping[str, Any], source_name: str = "knee") -> Knee:
    """Construct a knee from a mapping of its fields, as TOML or JSON gives it.

    Parameters
    ----------
    table : mapping of str to object
        Field and value; osteophytes and cysts are lists of tables.
    source_name : str, default "knee"
        Name of the file or object, which begins every error message.

    Returns
    -------
    Knee
        The knee.

    Raises
    ------
    InputError
        If a field is misspelt or a value is not allowed.
    """
    table = update_field_names(table, RENAMED_FIELDS, source_name)
    for name, kind in _LIST_FIELDS.items():
        items, size = table.get(name, ()), fields(kind)[1].name
        if not isinstance(items, list | tuple) or not all(isinstance(item, Mapping) for item in items):
            raise InputError(f"{source_name}: {name} must be a list of tables with site and {size}, got {items!r}")
        one = kind.__name__.lower()
        table[name] = tuple(build_from_table(cast(Any, kind), item, f"{source_name}: {one}") for item in items)
    return build_from_table(Knee, table, source_name)


def knee_to_dict(knee: Knee) -> dict[str, Any]:
    """Convert a knee to a JSON-ready mapping, which `knee_from_dict` reads.

    Parameters
    ----------
    knee : Knee
        The knee.

    Returns
    -------
    dict of str to object
        Field and value; osteophytes and cysts are lists of tables.
    """
    return {
        **asdict(knee),
        "shape": list(knee.shape),
        **{name: [asdict(item) for item in getattr(knee, name)] for name in _LIST_FIELDS},
    }
