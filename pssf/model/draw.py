"""draw_knee, draw_pair: a grade and chance -> a knee, or both of a person, by a table of grades."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.checks import from_table, require_choice, require_generator, require_whole
from ..data.fields import FieldLaw, field_laws
from ..data.grades import RangeGrades, SeverityGrades, grade_table
from ..data.limbs import Limbs, limbs
from ..data.records import Pair
from ..data.shapes import shape_table
from ..data.spongy import trabecular_bone
from .knee import BORDER_SITES, MOST_SD, Knee, Osteophyte
from .severity import severity_fields

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

    grades   table of grades
    modes    of the bones' shape, how many
    limbs    what BMI gives a limb
    bmi      what it may be
    density  mean and deviation of `Knee.bone_density`
    """

    grades: RangeGrades | SeverityGrades
    modes: int
    limbs: Limbs
    bmi: FieldLaw
    density: Pair


def draw_laws(table: str) -> DrawLaws:
    """The laws of a table of grades, by its name or path, and of what is drawn alike in all.

    raises  InputError for an unknown table
    """
    return DrawLaws(
        grades=grade_table(table),
        modes=len(shape_table().modes),
        limbs=limbs(),
        bmi=field_laws("knee")["bmi"],
        density=trabecular_bone().person.density,
    )


def draw_knee(*, grade: int, rng: np.random.Generator, table: str = "paper", **fixed: Any) -> Knee:
    """A knee of a KL grade with parameters drawn by a table of grades.

    rng    the only source of chance; size and pose are drawn from it, texture's seed, shape and BMI from children
    table  "paper", whose ranges make grades 0 to 2 a function of the joint space, "people", whose grades 0 to 4 overlap
           as people's do and whose joint spaces are those that readers take, or the path of a TOML file
    fixed  fields of `Knee` to hold at a value; the draw of the others does not depend on them, but for sizes that go
           with sex, and for limb and fat, which go with BMI
    raises InputError for an unknown grade, table or field, or a rng that is none
    """
    return drawn_knee(draw_laws(table), grade=grade, rng=rng, **fixed)


def drawn_knee(laws: DrawLaws, *, grade: int, rng: np.random.Generator, **fixed: Any) -> Knee:
    """`draw_knee` by laws that are known."""
    law = laws.grades
    require_whole("grade", grade, min(law.grades), max(law.grades), "")
    require_generator(rng)
    men = 0.5 if isinstance(law, RangeGrades) else 1 - law.rest.women[grade]
    sex = fixed.get("sex", "male" if rng.random() < men else "female")
    require_choice("sex", sex, ("male", "female"))
    drawn: dict[str, Any] = {"sex": sex, "grade": int(grade), "side": "right" if rng.random() < 0.5 else "left"}
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
    if isinstance(law, SeverityGrades) and law.skin_folds is not None:
        most = np.interp(bmi, *np.array(law.skin_folds.most).T)
        drawn["skin_folds"] = round(float(most) * rng.spawn(1)[0].random(), 4)
    if isinstance(law, SeverityGrades) and law.hip is not None:
        angle_deg = _normal(rng.spawn(1)[0], law.hip.mechanical_axis_deg, sex)
        drawn["mechanical_axis_deg"] = float(np.clip(angle_deg, 1.0, 9.0))
    return from_table(Knee, {**drawn, **fixed}, "draw_knee")


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


def draw_pair(*, grade: int, rng: np.random.Generator, table: str = "paper", **fixed: Any) -> tuple[Knee, Knee]:
    """Right and left knee of a person, both of a KL grade: of one body, each with a joint of its own.

    Arguments as in `draw_knee`, but for the side.
    """
    require_generator(rng)
    laws = draw_laws(table)
    of_body, *of_knees = rng.spawn(3)
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
