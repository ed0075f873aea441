"""GradeTable: what a drawn knee of a grade may be, as `data/grades/*.toml` or a user's own file has it."""

from collections.abc import Sized
from functools import cache
from pathlib import Path

from ..core.checks import InputError, require_path
from .records import Numbers, Pair, Record, Rows, record
from .tables import read_toml

_FOLDER = Path(__file__).resolve().parent / "grades"
Laws = tuple[Pair, ...]


class GradeRanges(Record, frozen=True):
    """Bounds of what is drawn evenly; mm, degrees, the plate relative to a healthy one."""

    jsw_medial_mm: Pair
    jsw_lateral_mm: Pair
    osteophyte_count: tuple[int, int]
    largest_osteophyte_mm: Pair
    subchondral_plate: Pair
    varus_deg: Pair


class Fabellae(Record, frozen=True):
    """Share of knees that have a fabella, and bounds of its size."""

    share: float
    size_mm: Pair


class Side(Record, frozen=True):
    """Share of knees that narrow medially, and correlation of severity with what narrows, grows, hardens and slips."""

    medial: float
    shape_with: float


class Spaces(Record, frozen=True):
    """Joint spaces as readers take them, mm: correlation of both, the least drawn, what men have more, laws by side.

    medial, lateral  grade -> mean and deviation of the space that narrows and of the other one
    """

    correlation: float
    least_mm: float
    men_more_mm: float
    medial: dict[str, tuple[Pair, Pair]]
    lateral: dict[str, tuple[Pair, Pair]]


class Around(Record, frozen=True):
    """What else is on the margin of an osteophyte of from_mm or more: in front of it in such a share, and behind it.

    place, size  where between its middle (0) and its end (1), and of the first one's size, between these
    """

    from_mm: float
    share: float
    place: Pair
    size: Pair


class Margins(Record, frozen=True):
    """Latent OARSI grades of osteophytes, by KL grade and site, and the sizes that each stands for, mm.

    spine, spine_other  share of knees whose spine of the narrowed side is spiked, by KL grade; the other's over that
    curve_deg           site -> mean and deviation of how far its lips curve towards the joint
    """

    level: Numbers
    site: dict[str, float]
    narrowed_side: float
    person_sd: float
    site_sd: float
    size_mm: tuple[Pair, Pair, Pair, Pair]
    doubtful_mm: float
    spine: Numbers
    spine_other: float
    spine_mm: Pair
    around: Around
    curve_deg: dict[str, Pair]


class Central(Record, frozen=True):
    """Share of knees that have an osteophyte in the middle of a joint surface, by grade, and bounds of its size.

    femur, narrowed  shares of them on the femur, and on the side that narrows
    """

    share: Numbers
    femur: float
    narrowed: float
    size_mm: Pair


class Rest(Record, frozen=True):
    """What else a grade moves: means and deviations, factors and shares by grade."""

    plate: Laws
    varus_deg: Laws
    lean_per_varus: float
    wider: Numbers
    age_years: Laws
    women: Numbers
    bmi_more: Numbers
    density_more: Numbers


class Cysts(Record, frozen=True):
    """Share of knees that have subchondral cysts, by grade; how many then, where, and bounds of their size.

    tibia, narrowed  shares of cysts in the tibia, and on the side that narrows
    """

    share: Numbers
    most: int
    tibia: float
    narrowed: float
    diameter_mm: Pair


class Notch(Record, frozen=True):
    """Mean and deviation of what has grown into the notch by grade, and what it may be."""

    growth_mm: Laws
    bounds_mm: Pair


class Effusion(Record, frozen=True):
    """Mean and deviation of how much the joint is swollen by grade, mm, least and most."""

    swelling_mm: Laws
    bounds_mm: Pair


class SkinFolds(Record, frozen=True):
    """The deepest that a person's folds of skin may be; less is as likely.

    most  rows of BMI, kg/m2, and share of the fat
    """

    most: Rows


class Hip(Record, frozen=True):
    """Where a hip's centre is seen from the knee: mean and deviation of the femur's mechanical axis from its shaft."""

    mechanical_axis_deg: Pair


class Subluxation(Record, frozen=True):
    """Of the tibia to lateral where the medial side narrows, mm: mean and deviation by grade, least and most."""

    lateral_mm: Laws
    bounds_mm: Pair


class Reader(Record, frozen=True):
    """Kappa of the grade that is read with the one that is meant."""

    kappa: float


class _Shared(Record, frozen=True):
    """Drawn alike in every grade.

    body   field of a knee -> mean and standard deviation, of both sexes or of each
    pose   field of a knee -> bounds
    form   as body, of what is drawn with the scores of the shape
    """

    body: dict[str, Pair | dict[str, Pair]]
    pose: dict[str, Pair]
    form: dict[str, Pair | dict[str, Pair]]
    fabella: Fabellae


class RangeGrades(_Shared, frozen=True):
    """Grades by ranges of each parameter: grade -> its ranges."""

    grade: dict[str, GradeRanges]

    @property
    def grades(self) -> tuple[int, ...]:
        """All grades, rising."""
        return tuple(sorted(int(name) for name in self.grade))


class SeverityGrades(_Shared, frozen=True):
    """Grades by a latent severity, which spaces, osteophytes, plate, alignment, growth and slip follow in part."""

    side: Side
    spaces: Spaces
    osteophytes: Margins
    rest: Rest
    reader: Reader
    central: Central | None = None
    cysts: Cysts | None = None
    subluxation: Subluxation | None = None
    notch: Notch | None = None
    effusion: Effusion | None = None
    skin_folds: SkinFolds | None = None
    hip: Hip | None = None

    @property
    def grades(self) -> tuple[int, ...]:
        """All grades, rising."""
        return tuple(range(len(self.rest.wider)))


def grade_tables() -> list[str]:
    """Names of the tables that come with the package."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


@cache
def grade_table(name_or_path: str = "paper") -> RangeGrades | SeverityGrades:
    """A table of grades by name, or from a TOML file.

    raises  InputError for an unknown name, a file that is not readable TOML, or one that is no table of grades
    """
    path = _path(name_or_path)
    table = read_toml(path)
    base = table.pop("base", None)
    if base is not None:
        shared = read_toml(_path(base))
        # In the base's order, by which values are drawn.
        of_base = {name: shared[name] for name in ("body", "pose", "form", "fabella") if name in shared}
        table |= {name: {**part, **table.get(name, {})} for name, part in of_base.items()}
    kind: type[RangeGrades] | type[SeverityGrades] = RangeGrades if "grade" in table else SeverityGrades
    try:
        made = record(kind, table, f"grades {path.name}")
    except ValueError as error:
        raise InputError(str(error)) from None
    if isinstance(made, SeverityGrades):
        _require_every_grade(made, path.name)
    return made


def _path(name_or_path: str) -> Path:
    require_path(name_or_path, "grades")
    if Path(name_or_path).suffix == ".toml":
        return Path(name_or_path)
    if str(name_or_path) not in grade_tables():
        allowed = ", ".join(grade_tables())
        raise InputError(f"grades = {str(name_or_path)!r}; allowed: {allowed}, or the path of a .toml file")
    return _FOLDER / f"{name_or_path}.toml"


def _require_every_grade(table: SeverityGrades, name: str) -> None:
    grades = [str(grade) for grade in table.grades]
    lists: dict[str, Sized] = {
        "osteophytes.level": table.osteophytes.level,
        "osteophytes.spine": table.osteophytes.spine,
        "rest.plate": table.rest.plate,
        "rest.varus_deg": table.rest.varus_deg,
        "rest.age_years": table.rest.age_years,
        "rest.women": table.rest.women,
        "rest.bmi_more": table.rest.bmi_more,
        "rest.density_more": table.rest.density_more,
    }
    if table.central is not None:
        lists["central.share"] = table.central.share
    if table.cysts is not None:
        lists["cysts.share"] = table.cysts.share
    if table.subluxation is not None:
        lists["subluxation.lateral_mm"] = table.subluxation.lateral_mm
    if table.notch is not None:
        lists["notch.growth_mm"] = table.notch.growth_mm
    for entry, values in lists.items():
        if len(values) != len(grades):
            raise InputError(f"grades {name}: {entry} has {len(values)} entries; allowed: {len(grades)}, as rest.wider")
    for entry, laws in (("spaces.medial", table.spaces.medial), ("spaces.lateral", table.spaces.lateral)):
        if sorted(laws) != grades:
            raise InputError(f"grades {name}: {entry} has {', '.join(sorted(laws))}; allowed: {', '.join(grades)}")
