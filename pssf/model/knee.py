"""Define the parameters of one knee with its osteophytes and cysts, and check them at construction."""

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
# Smallest distance between two osteophytes or cysts at the same site, in units of `place`. Closer osteophytes or cysts
# would merge.
MIN_POSITION_SPACING = 0.5
# Maximum number of cysts. More cysts are rare in patients, and six cysts still fit into an epiphysis.
MAX_CYSTS = 6
# Difference between the medial and the lateral joint space above which the lateral compartment counts as narrowed, in
# mm. Smaller differences also occur in healthy subjects (the SD of each compartment is 0.7 to 1 mm).
_CLEAR_DIFFERENCE_MM = 1.0
# Osteophyte sites at the joint margins and on the tibial spines.
MARGIN_AND_SPINE_SITES = (
    "medial_femur",
    "lateral_femur",
    "medial_tibia",
    "lateral_tibia",
    "medial_spine",
    "lateral_spine",
)
# Osteophyte sites in the middle of a joint surface.
CENTRAL_SITES = ("medial_condyle", "lateral_condyle", "medial_plateau", "lateral_plateau")
# All osteophyte sites.
OSTEOPHYTE_SITES = MARGIN_AND_SPINE_SITES + CENTRAL_SITES
# Bone of each osteophyte site, keyed by the second word of the site name.
BONE_OF_SITE_PART = {"femur": "femur", "condyle": "femur", "tibia": "tibia", "plateau": "tibia", "spine": "tibia"}
# Largest size of a central osteophyte, in mm (assumed).
_MAX_CENTRAL_SIZE_MM = 5.0


def other_compartment(side: str) -> str:
    """Return the opposite compartment.

    Parameters
    ----------
    side : {"medial", "lateral"}
        Compartment of the tibiofemoral joint.

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
        Location of the osteophyte: bone margin, tibial spine, or joint surface (condyle or plateau). Allowed:
        "medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia", "medial_spine", "lateral_spine",
        "medial_condyle", "lateral_condyle", "medial_plateau", "lateral_plateau".
    size_mm : float
        Maximum height of the osteophyte above the original bone surface; at most 5 mm on a joint surface. Allowed: 0.2
        to 10 mm.
    place : float, default 0
        Position along the margin or across the joint surface: -1 is anterior, 1 is posterior. At a margin, 0 is the
        most medial or lateral point of the bone. Must be 0 on a tibial spine. Allowed: -1 to 1.
    curve_deg : float, default 0
        Curvature of the edge towards the joint; negative values curve away from the joint. Must be 0 on a tibial spine
        and on a joint surface. Allowed: -45 to 45 degrees.

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

    # Deprecated names, available for one more version.
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
        """Whether the osteophyte is in the middle of a joint surface."""
        return self.site in CENTRAL_SITES

    @property
    def max_size_mm(self) -> float:
        """Largest osteophyte size allowed at the site, in mm; infinite if the site has no limit of its own."""
        return _MAX_CENTRAL_SIZE_MM if self.is_central else float("inf")

    @property
    def bone(self) -> str:
        """Bone that carries the osteophyte, "femur" or "tibia"."""
        return BONE_OF_SITE_PART[self.site.split("_")[1]]


@check_keywords()
@dataclass(frozen=True, kw_only=True)
class Cyst:
    """Subchondral cyst: a sphere of marrow with a compact wall, in trabecular bone below the subchondral bone plate.

    Parameters
    ----------
    site : {"medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia"}
        Bone and compartment of the cyst.
    diameter_mm : float
        Diameter of the soft interior of the cyst, without the wall. Allowed: 1.5 to 15 mm.
    place : float, default 0
        Anteroposterior position in the compartment: -1 is anterior, 0 is the middle, 1 is posterior. Allowed: -1 to 1.
    outward : float, default 0.5
        Mediolateral position in the compartment: 0 is nearest to the notch, 1 is nearest to the margin. Allowed: 0 to
        1.

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


# Current field name, keyed by deprecated field name.
RENAMED_FIELDS = {"jsw_as": "jsw_definition", "grade_read": "reader_grade"}


@check_keywords(**RENAMED_FIELDS)
@dataclass(frozen=True, kw_only=True)
class Knee:
    """Parameters of one knee; the defaults describe the healthy right knee of a man of mean stature.

    Parameters
    ----------
    side : {"right", "left"}, default "right"
        Side of the body; a left knee is the mirror image of a right knee in x.
    sex : {"male", "female"}, default "male"
        Sex of the person, which determines the mean sizes of bones and limb.
    stature_mm : float, default 1755
        Stature of the person, which scales the bones. Allowed: 1400 to 2100 mm.
    jsw_medial_mm : float, default 5
        Medial joint space width, measured according to jsw_definition. Allowed: 0 to 10 mm.
    jsw_lateral_mm : float, default 5
        Lateral joint space width, measured according to jsw_definition. Allowed: 0 to 10 mm.
    jsw_definition : {"projected", "read"}, default "projected"
        Definition of both joint space widths. "projected": smallest vertical gap between the projected cortical
        contours in the protocol reference. "read": gap that readers measure in the protocol fixed_flexion, from the
        femoral contour to the line through the tibial contour landmarks. In the medial compartment, the line follows
        the floor of the plateau.
    osteophytes : tuple of Osteophyte, default ()
        Osteophytes. Two osteophytes at the same site must differ by at least 0.5 in `Osteophyte.place`.
    subchondral_plate : float, default 1
        Thickness of the subchondral bone plate relative to a healthy plate, in the sclerotic compartment. The sclerotic
        compartment is the narrowed compartment, or the medial compartment if no compartment is narrowed. Allowed: 0.5
        to 2.5.
    varus_deg : float, default 0
        Angle between the shafts of femur and tibia, relative to the normal valgus of 5 degrees; positive is varus.
        Allowed: -16 to 16 degrees.
    flexion_deg : float, default 0
        Flexion of the knee: rotation of the femur about the mediolateral axis. Allowed: 0 to 15 degrees.
    rotation_deg : float, default 0
        Rotation of the leg about its long axis; positive is internal. Allowed: -10 to 10 degrees.
    bone_scale : float, default 1
        Size of the bones relative to the mean for sex and stature. Allowed: 0.85 to 1.15.
    shape : tuple of float, default ()
        Scores of the modes of bone shape (``data/shapes.toml``), each -3 to 3 standard deviations from the population
        mean. Missing scores at the end are 0.
    form_seed : int, default 0
        Seed of random details that are not part of the bone shape modes: positions of spines and notch, curvature of
        the lateral plateau, positions of skin folds. Allowed: 0 to 2**63 - 1.
    cortex_scale : float, default 1
        Cortical thickness relative to the mean. Allowed: 0.6 to 1.5.
    tibial_slope_deg : float, default 5
        Posterior slope of the tibial plateau. Allowed: -2 to 18 degrees.
    lean_deg : float, default 3
        Angle between the tibial shaft and the vertical on the radiograph; positive values move the foot medially.
        Allowed: -15 to 15 degrees.
    fibular_tip_mm : float, default 12
        Distance from the middle of the plateau down to the tip of the fibula. Allowed: 4 to 28 mm.
    insall_salvati : float, default 1.14
        Insall-Salvati ratio: length of the patellar tendon divided by length of the patella. Allowed: 0.6 to 1.8.
    patellar_shift_mm : float, default 3
        Lateral distance from the middle of the femur to the middle of the patella. Allowed: -10 to 15 mm.
    patellar_tilt_deg : float, default 3
        Rotation of the patella about its long axis; positive values move the lateral edge backwards. Allowed: -15 to 20
        degrees.
    fabella_mm : float, default 0
        Height of the fabella; 0 means no fabella. Allowed: 0 to 15 mm.
    bmi : float, default 27
        Body mass index of the person, which determines limb_ap_mm and fat_mm if they are None. Allowed: 15 to 50 kg/m2.
    limb_ap_mm : float, optional
        Anteroposterior thickness of the limb at the joint. None: the mean for BMI and sex, which is 122 mm for men and
        118 mm for women at a BMI of 28.6 and increases by 1.5 mm per kg/m2. Allowed: 90 to 180 mm.
    fat_mm : float, optional
        Thickness of the subcutaneous fat on the medial and the lateral side. None: the mean for BMI and sex, which is
        10 mm for men and 12.5 mm for women at a BMI of 28.6 and increases by 0.8 and 1 mm per kg/m2. Allowed: 2 to 40
        mm.
    age_years : float, default 55
        Age of the person; the trabeculae become thinner with age. Allowed: 18 to 100 years.
    bone_density : float, default 1
        Density of the trabecular bone relative to the mean for age and sex. Allowed: 0.4 to 1.8.
    texture_seed : int, default 0
        Seed of the random trabeculae, cortical unevenness and surface roughness, which do not change when other fields
        change. Allowed: 0 to 2**63 - 1.
    grade : int, optional
        KL grade for which the knee was sampled. None: Truth.grade is derived from the anatomy. Allowed: 0, 1, 2, 3, 4.
    grade_table : str, optional
        Grade table from which the knee was sampled. None: the knee was specified by its fields. Allowed: text of 1 to
        255 characters.
    reader_grade : int, optional
        KL grade assigned by a simulated reader, which may differ from the KL grade by one. None: no reader is
        simulated. Allowed: 0, 1, 2, 3, 4.
    cysts : tuple of Cyst, default ()
        Subchondral cysts, at most 6. Two cysts at the same site must differ by at least 0.5 in `Cyst.place`.
    subluxation_mm : float, default 0
        Displacement of the tibia relative to the femur; positive is lateral. Joint space widths do not change. Allowed:
        -6 to 6 mm.
    notch_growth_mm : float, default 0
        Bone growth into the intercondylar notch, on notch walls, notch roof and eminence; the plateau floors grow less.
        Allowed: 0 to 3 mm.
    effusion_mm : float, default 0
        Additional thickness of capsule, synovium and joint fluid compared with a healthy joint. Allowed: 0 to 10 mm.
    skin_folds : float, default 0
        Greatest depth of the skin folds, as a fraction of the thickness of the subcutaneous fat below; 0 means no
        folds. Allowed: 0 to 0.85.
    mechanical_axis_deg : float, default 5.4
        Angle between the femoral shaft and the mechanical axis of the femur, which ends at the hip centre. The hip is
        outside the image, so only the label hip_knee_ankle_deg depends on this angle. Allowed: 1 to 9 degrees.

    Raises
    ------
    InputError
        If a value is out of range (``data/knee_fields.toml``), two osteophytes or cysts at the same site are too close,
        or `grade` contradicts the anatomy (`kellgren_lawrence.allowed_grades`).

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
    # None is replaced by the mean for the BMI and sex of the knee when the knee is constructed.
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

    # Deprecated names, available for one more version.
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
        """Sclerotic compartment: "lateral" if the lateral joint space is clearly narrower, else "medial"."""
        return "lateral" if self.jsw_medial_mm - self.jsw_lateral_mm > _CLEAR_DIFFERENCE_MM else "medial"


# Dataclass of the tuple entries, keyed by the name of the `Knee` field that contains the tuple.
_LIST_FIELDS: dict[str, type[Osteophyte] | type[Cyst]] = {"osteophytes": Osteophyte, "cysts": Cyst}


def _require_spacing(name: str, items: Sequence[Osteophyte | Cyst]) -> None:
    """Check that osteophytes or cysts at the same site are far enough apart."""
    ordered = sorted(items, key=lambda item: (item.site, item.place))
    for one, other in pairwise(ordered):
        if one.site == other.site and other.place - one.place < MIN_POSITION_SPACING:
            raise InputError(
                f"{name} at {one.site} must differ by at least {MIN_POSITION_SPACING:g} in place, got places "
                f"{one.place:g} and {other.place:g}"
            )


def require_shape_scores(scores: Any, modes: Sequence[ShapeMode]) -> tuple[float, ...]:
    """Check the scores of the bone shape modes and remove trailing zeros.

    Parameters
    ----------
    scores : sequence of float
        One score per mode, in standard deviations; scores of the last modes may be omitted.
    modes : sequence of ShapeMode
        Modes of the shape model.

    Returns
    -------
    tuple of float
        Scores in standard deviations, without trailing zeros.

    Raises
    ------
    InputError
        If `scores` is not a sequence, is longer than `modes`, or contains a value that is not a number from -3 to 3.
    """
    scores = scores.tolist() if hasattr(scores, "tolist") else scores  # Convert a numpy array to a list.
    if not isinstance(scores, tuple | list) or len(scores) > len(modes):
        raise InputError(f"shape must be a sequence of up to {len(modes)} numbers, one per mode, got {scores!r}")
    for mode, score in zip(modes, scores, strict=False):
        require_in_range(f"shape score {mode.name}", score, -MAX_SHAPE_SD, MAX_SHAPE_SD, "SD")
    kept = [float(score) for score in scores]
    while kept and kept[-1] == 0.0:
        kept.pop()
    return tuple(kept)


def knee_from_dict(table: Mapping[str, Any], source_name: str = "knee") -> Knee:
    """Construct a knee from a mapping of its fields, such as a parsed TOML or JSON file.

    Parameters
    ----------
    table : mapping of str to object
        Values keyed by field name; osteophytes and cysts are lists of tables.
    source_name : str, default "knee"
        Name of the file or object, shown at the start of error messages.

    Returns
    -------
    Knee
        Constructed and checked knee.

    Raises
    ------
    InputError
        If a field name is unknown or a value is not allowed.
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
    """Convert a knee to a JSON-compatible mapping, which `knee_from_dict` converts back.

    Parameters
    ----------
    knee : Knee
        Knee to convert.

    Returns
    -------
    dict of str to object
        Values keyed by field name; osteophytes and cysts are lists of tables.
    """
    return {
        **asdict(knee),
        "shape": list(knee.shape),
        **{name: [asdict(item) for item in getattr(knee, name)] for name in _LIST_FIELDS},
    }
