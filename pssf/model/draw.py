"""draw_knee, draw_pair: a grade and chance -> a knee, or both of a person, by a table of grades."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from ..core.checks import Chance, InputError, from_table, generator_of, require_choice
from ..core.keywords import keywords
from ..data.fields import FieldLaw, field_laws
from ..data.grade_tables import grade_table, grade_table_name, tables_with
from ..data.grades import RangeGrades, SeverityGrades
from ..data.limbs import Limbs, limbs
from ..data.records import Pair
from ..data.shapes import shape_table
from ..data.spongy import trabecular_bone
from .knee import BORDER_SITES, MOST_SD, Knee, Osteophyte
from .severity import severity_fields

# Table of grades that knees are sampled from where none is named.
DEFAULT_TABLE = "population"
# No value of a normal law is farther from its mean.
_FARTHEST_SD = 2.0
# What the two knees of a person share.
_BODY_FIELDS = (
    "sex", "stature_mm", "bone_scale", "cortex_scale", "bmi", "limb_ap_mm", "fat_mm", "skin_folds", "age_years",
    "bone_density", "shape", "fibular_tip_mm", "insall_salvati", "fabella_mm", "mechanical_axis_deg",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawLaws:
    """What knees are drawn by.

    table    name of the table of grades, or the file name of one's own
    grades   table of grades
    modes    of the bones' shape, how many
    limbs    what BMI gives a limb
    bmi      what it may be
    density  mean and deviation of `Knee.bone_density`
    """

    table: str
    grades: RangeGrades | SeverityGrades
    modes: int
    limbs: Limbs
    bmi: FieldLaw
    density: Pair


def draw_laws(table: str) -> DrawLaws:
    """Resolve the laws of a table of grades, by its name or path, and of what is sampled alike in all.

    raises  InputError for an unknown table
    """
    grades = grade_table(table)
    own = Path(table).suffix == ".toml"
    return DrawLaws(
        table=Path(table).name if own else grade_table_name(str(table)),
        grades=grades,
        modes=len(shape_table().modes),
        limbs=limbs(),
        bmi=field_laws("knee")["bmi"],
        density=trabecular_bone().person.density,
    )


@keywords(table="grade_table")
def draw_knee(*, grade: int, rng: Chance, grade_table: str = DEFAULT_TABLE, **fixed: Any) -> Knee:
    """Sample a knee of a KL grade from a table of grades.

    Parameters
    ----------
    grade : int
        KL grade, 0 to 4 in the table `population`, 0 to 2 in `paper`.
    rng : int or numpy.random.Generator
        The only source of chance. Size and pose are sampled from it; texture seed, shape and BMI from its children.
    grade_table : str, default "population"
        `population`, in which the grades overlap as in patients and joint spaces are those that readers measure;
        `paper`, in which the joint space alone separates grades 0 to 2; or the path of a TOML file.
    **fixed
        Fields of `Knee` to hold at a value. The other fields do not depend on them, except sizes, which depend on sex,
        and limb and fat, which depend on BMI.

    Returns
    -------
    Knee

    Raises
    ------
    InputError
        For an unknown grade, table or field, or an `rng` that is neither an integer nor a Generator.

    Examples
    --------
    >>> import pssf
    >>> knee = pssf.draw_knee(grade=2, rng=7)
    >>> knee.grade, knee.grade_table
    (2, 'population')
    """
    laws = draw_laws(grade_table)
    _require_grade(laws, grade, tables_with(grade))
    return drawn_knee(laws, grade=grade, rng=generator_of(rng), **fixed)


def _require_grade(laws: DrawLaws, grade: int, others: Sequence[str] = ()) -> None:
    """Refuse a grade that a table lacks; others: tables of the package that have it."""
    whole = isinstance(grade, Integral) and not isinstance(grade, bool)
    if whole and grade in laws.grades.grades:
        return
    hint = f": grade table {', '.join(others)} has it" if whole and others else ""
    allowed = ", ".join(map(str, laws.grades.grades))
    raise InputError(f"grade must be one of {allowed} in grade table {laws.table}, got {grade!r}{hint}")


def drawn_knee(laws: DrawLaws, *, grade: int, rng: np.random.Generator, **fixed: Any) -> Knee:
    """Sample a knee as `draw_knee` does, by laws that are resolved."""
    law = laws.grades
    _require_grade(laws, grade)
    men = 0.5 if isinstance(law, RangeGrades) else 1 - law.rest.women[grade]
    sex = fixed.get("sex", "male" if rng.random() < men else "female")
    require_choice("sex", sex, ("male", "female"))
    drawn: dict[str, Any] = {
        "sex": sex,
        "grade": int(grade),
        "grade_table": laws.table,
        "side": "right" if rng.random() < 0.5 else "left",
    }
    for name, shared in law.body.items():
        drawn[name] = _normal(rng, shared, sex)
    ranges = law.grade[str(int(grade))] if isinstance(law, RangeGrades) else None
    if ranges is not None:
        for name in ("jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg"):
            drawn[name] = _uniform(rng, getattr(ranges, name))
    for name, bounds in law.pose.items():
        drawn[name] = _uniform(rng, bounds)
    # One number for both: they are of different things.
    drawn["texture_seed"] = drawn["form_seed"] = int(rng.spawn(1)[0].integers(2**63))
    # From children of their own, so that all else is drawn as it would be without.
    drawn |= _draw_form(rng.spawn(1)[0], law, sex, laws.modes)
    if isinstance(law, SeverityGrades):
        drawn |= severity_fields(law, int(grade), sex, drawn["bone_scale"], rng.spawn(1)[0])
        # A leg in varus leans as much more, which keeps its joint line level.
        lean_deg = drawn["lean_deg"] + law.rest.lean_per_varus * drawn["varus_deg"]
        drawn["lean_deg"] = round(float(np.clip(lean_deg, -15.0, 15.0)), 4)
    elif ranges is not None:
        drawn["osteophytes"] = _draw_osteophytes(rng, ranges.osteophyte_count, ranges.largest_osteophyte_mm)
    rest = law.rest if isinstance(law, SeverityGrades) else None
    heavier, denser = (rest.bmi_more[grade], rest.density_more[grade]) if rest else (0.0, 0.0)
    bmi = fixed.get("bmi", round(_normal(rng.spawn(1)[0], laws.limbs.bmi, sex) + heavier, 4))
    laws.bmi.check("bmi", bmi)
    drawn |= _limb(bmi, sex, drawn, laws.limbs)
    drawn["bone_density"] = round(_normal(rng.spawn(1)[0], laws.density, sex) + denser, 4)
    if isinstance(law, SeverityGrades):
        drawn |= _skin_and_hip(law, bmi, sex, rng)
    return from_table(Knee, {**drawn, **fixed}, "draw_knee")


def _skin_and_hip(law: SeverityGrades, bmi: float, sex: str, rng: np.random.Generator) -> dict[str, float]:
    sampled = {}
    if law.skin_folds is not None:
        most = np.interp(bmi, *np.array(law.skin_folds.most).T)
        sampled["skin_folds"] = round(float(most) * rng.spawn(1)[0].random(), 4)
    if law.hip is not None:
        angle_deg = _normal(rng.spawn(1)[0], law.hip.mechanical_axis_deg, sex)
        sampled["mechanical_axis_deg"] = float(np.clip(angle_deg, 1.0, 9.0))
    return sampled


def draw_knees(laws: DrawLaws, count: int, seed: int, **fixed: Any) -> list[Knee]:
    """Knees of all grades, which take turns; knee k is the same in any number.

    fixed  as in `draw_knee`
    """
    grades = laws.grades.grades
    streams = (np.random.SeedSequence(seed, spawn_key=(index,)) for index in range(count))
    return [
        drawn_knee(laws, grade=grades[index % len(grades)], rng=np.random.default_rng(stream), **fixed)
        for index, stream in enumerate(streams)
    ]


@keywords(table="grade_table")
def draw_pair(*, grade: int, rng: Chance, grade_table: str = DEFAULT_TABLE, **fixed: Any) -> tuple[Knee, Knee]:
    """Sample the right and the left knee of a person, both of a KL grade: one body, two joints.

    Parameters
    ----------
    grade, rng, grade_table, **fixed
        As in `draw_knee`, except the side.

    Returns
    -------
    right, left : Knee

    Raises
    ------
    InputError
        As `draw_knee`.

    Examples
    --------
    >>> import pssf
    >>> right, left = pssf.draw_pair(grade=3, rng=7)
    >>> right.side, left.side, right.stature_mm == left.stature_mm
    ('right', 'left', True)
    """
    laws = draw_laws(grade_table)
    _require_grade(laws, grade, tables_with(grade))
    of_body, *of_knees = generator_of(rng).spawn(3)
    shared = fixed | draw_body(laws, grade=grade, rng=of_body, **fixed)
    right, left = (
        drawn_knee(laws, grade=grade, rng=of_knee, **shared, side=side)
        for of_knee, side in zip(of_knees, ("right", "left"), strict=True)
    )
    return right, left


def draw_body(laws: DrawLaws, *, grade: int, rng: np.random.Generator, **fixed: Any) -> dict[str, Any]:
    """The fields that the two knees of a person share, by name; arguments as in `drawn_knee`."""
    body = drawn_knee(laws, grade=grade, rng=rng, **fixed)
    return {name: getattr(body, name) for name in _BODY_FIELDS}


def _limb(bmi: float, sex: str, drawn: dict[str, Any], law: Limbs) -> dict[str, float]:
    """BMI and what a limb measures: the mean at that BMI and what was drawn about it."""
    about = {name: limb.held(limb.mean(bmi, sex) + drawn[name]) for name, limb in law.limb.items()}
    return {"bmi": bmi, **about}


def _draw_form(rng: np.random.Generator, table: RangeGrades | SeverityGrades, sex: str, modes: int) -> dict[str, Any]:
    """Scores of so many modes of the shape, and how the small bones lie."""
    scores = rng.standard_normal(modes).clip(-MOST_SD, MOST_SD)
    form: dict[str, Any] = {"shape": tuple(round(float(score), 4) for score in scores)}
    form |= {name: _normal(rng, law, sex) for name, law in table.form.items()}
    has, size_mm = rng.random() < table.fabella.share, _uniform(rng, table.fabella.size_mm)
    return form | {"fabella_mm": size_mm if has else 0.0}


def _normal(rng: np.random.Generator, law: Pair | dict[str, Pair], sex: str) -> float:
    mean, sd = law[sex] if isinstance(law, dict) else law
    return round(mean + sd * min(_FARTHEST_SD, max(-_FARTHEST_SD, rng.standard_normal())), 4)


def _draw_osteophytes(
    rng: np.random.Generator, count_range: tuple[int, int], largest_range: Pair
) -> tuple[Osteophyte, ...]:
    count = int(rng.integers(count_range[0], count_range[1] + 1))
    largest = _uniform(rng, largest_range)
    sites = rng.permutation(len(BORDER_SITES))
    shares = rng.uniform(0.3, 1.0, len(BORDER_SITES))
    shares[0] = 1.0
    sized = [(BORDER_SITES[sites[i]], round(largest * float(shares[i]), 4)) for i in range(count)]
    # Below 0.2 mm an osteophyte cannot be told from the margin's own rounding, nor seen in a 0.15 mm pixel.
    return tuple(Osteophyte(site=site, size_mm=size) for site, size in sized if size >= 0.2)


def _uniform(rng: np.random.Generator, bounds: Pair) -> float:
    return round(float(rng.uniform(bounds[0], bounds[1])), 4)
