"""progress: a knee, years and chance -> the same knee later; true_change: what is other in it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.checks import Array, Chance, InputError, generator_of, require
from ..core.keywords import keywords
from ..data.fields import FieldLaw, field_laws
from ..data.oarsi import OarsiCuts, oarsi_cuts
from ..data.progress import Progress, Step, progress_law
from ..data.records import Pair
from .kellgren_lawrence import MARGINS, MOST_GRADE, SIDES, allowed_grades, largest_osteophyte_mm, narrowed
from .knee import Knee, Osteophyte, other_compartment

_MOST_YEARS = 40
# Fields whose change is a number.
_CHANGED = (
    "jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg", "notch_growth_mm", "effusion_mm", "age_years",
)  # fmt: skip


@keywords()
def progress(knee: Knee, years: float, rng: Chance) -> Knee:
    """Age a knee: the same person's knee after some years, with no joint space wider and no osteophyte smaller.

    Shape, size, posture, limb, cysts and the seed of its texture are kept. Its rates are sampled before the years are
    looked at: with the same seed a knee has one course, of which each time is a visit.

    Parameters
    ----------
    knee : Knee
        At the first visit.
    years : float
        0 to 40.
    rng : int or numpy.random.Generator
        The only source of chance.

    Returns
    -------
    Knee

    Raises
    ------
    InputError
        For anything but a Knee, years out of range or beyond the oldest age, or an `rng` that is neither an integer
        nor a Generator.

    Examples
    --------
    >>> import pssf
    >>> first = pssf.draw_knee(grade=2, rng=7)
    >>> pssf.progress(first, 2.0, rng=1).jsw_medial_mm <= first.jsw_medial_mm
    True
    """
    if not isinstance(knee, Knee):
        raise InputError(f"knee = {knee!r}; allowed: a Knee")
    rng = generator_of(rng)
    require("years", years, 0, _MOST_YEARS, "years")
    law, cuts, of_varus = progress_law(), oarsi_cuts(), field_laws("knee")["varus_deg"]
    definite_mm = law.step.definite_mm[MOST_GRADE if knee.grade is None else knee.grade]
    stage = _stage(knee, law.step, cuts, definite_mm)
    lost_already = {side: narrowed(knee, side, cuts) for side in SIDES}
    course = _draw_course(law, knee, stage if knee.grade is None else knee.grade, lost_already, rng)
    other = other_compartment(course.narrows)
    lost = {course.narrows: years * course.loss_mm, other: years * course.loss_mm * law.other}
    spaces: dict[str, Any] = {
        f"jsw_{side}_mm": round(max(0.0, _space_mm(knee, side) - mm), 4) for side, mm in lost.items()
    }
    fell = {side: _space_mm(knee, side) - spaces[f"jsw_{side}_mm"] for side in SIDES}
    varus_deg = knee.varus_deg + law.varus_deg_per_mm * (fell["medial"] - fell["lateral"])
    later = replace(
        knee,
        **spaces,
        grade=None,
        osteophytes=_grown(knee, years, course, law),
        subchondral_plate=_risen(knee.subchondral_plate, years * course.plate, law.most_plate),
        notch_growth_mm=_risen(knee.notch_growth_mm, years * course.notch_mm, law.most_notch_mm),
        effusion_mm=_risen(knee.effusion_mm, years * course.swelling_mm, law.most_swelling_mm),
        varus_deg=_held(varus_deg, of_varus),
        age_years=round(knee.age_years + years, 4),
    )
    if knee.grade is None:
        return later
    low, high = allowed_grades(later, cuts)
    stepped = knee.grade + _stage(later, law.step, cuts, definite_mm) - stage
    # No lower than before: nothing heals.
    grade = min(MOST_GRADE, max(knee.grade, low, min(stepped, high)))
    read = None if knee.grade_read is None else min(MOST_GRADE, knee.grade_read + grade - knee.grade)
    return replace(later, grade=grade, grade_read=read)


def true_change(before: Knee, after: Knee) -> dict[str, float]:
    """Compare two visits of a knee: the change of every field that `progress` changes.

    Parameters
    ----------
    before, after : Knee
        The same knee at two visits.

    Returns
    -------
    dict of str to float
        Field -> value after less value before, of joint spaces, subchondral bone plate, varus, growth into the notch,
        effusion and age; `largest_osteophyte_mm` and `osteophyte_count`; and `grade_change`, the steps of KL grade,
        where both knees have a grade.

    Raises
    ------
    InputError
        For anything but two knees.

    Examples
    --------
    >>> import pssf
    >>> first = pssf.draw_knee(grade=2, rng=7)
    >>> pssf.true_change(first, pssf.progress(first, 2.0, rng=1))["age_years"]
    2.0
    """
    for called, knee in (("before", before), ("after", after)):
        if not isinstance(knee, Knee):
            raise InputError(f"{called} = {knee!r}; allowed: a Knee")
    change = {name: round(getattr(after, name) - getattr(before, name), 4) for name in _CHANGED}
    sizes = [[one.size_mm for one in knee.osteophytes] for knee in (before, after)]
    change["largest_osteophyte_mm"] = round(max(sizes[1], default=0.0) - max(sizes[0], default=0.0), 4)
    change["osteophyte_count"] = len(sizes[1]) - len(sizes[0])
    if before.grade is not None and after.grade is not None:
        change["grade_change"] = after.grade - before.grade
    return change


@dataclass(frozen=True)
class _Course:
    """Of a year: loss of the side that narrows, growth, thickening, and growth into the notch and swelling; of each
    osteophyte a factor of the growth.

    arises_years  (4,)  when an osteophyte comes up at each margin that has none
    factors       (osteophytes + 4,)  those that there are, then the margins'
    """

    narrows: str
    loss_mm: float
    growth_mm: float
    plate: float
    arises_years: Array
    factors: Array
    notch_mm: float
    swelling_mm: float


def _draw_course(law: Progress, knee: Knee, grade: int, lost: dict[str, float], rng: np.random.Generator) -> _Course:
    """lost: side -> share of a healthy space that it has lost already."""
    drawn = "medial" if rng.random() < law.medial else "lateral"
    narrower = max(SIDES, key=lambda side: lost[side])
    loss, growth, plate = (_gamma(of[grade], rng) for of in (law.loss_mm, law.osteophyte_mm, law.plate))
    return _Course(
        narrows=narrower if grade >= law.side_is_told else drawn,
        loss_mm=loss,
        growth_mm=growth,
        plate=plate,
        arises_years=rng.exponential(1 / law.new_a_year[grade], len(MARGINS)),
        factors=rng.uniform(*law.of_each, len(knee.osteophytes) + len(MARGINS)),
        notch_mm=_gamma(law.notch_mm[grade], rng),
        swelling_mm=_gamma(law.swelling_mm[grade], rng),
    )


def _gamma(law: Pair, rng: np.random.Generator) -> float:
    mean, sd = law
    return float(rng.gamma((mean / sd) ** 2, sd**2 / mean))


def _grown(knee: Knee, years: float, course: _Course, law: Progress) -> tuple[Osteophyte, ...]:
    """Osteophytes that there were, larger, and those that have come up meanwhile."""
    grown = []
    for one, factor in zip(knee.osteophytes, course.factors, strict=False):
        size_mm = min(law.most_mm, one.tallest_mm, one.size_mm + years * course.growth_mm * factor)
        grown.append(replace(one, size_mm=round(max(one.size_mm, float(size_mm)), 4)))
    bare = course.factors[len(knee.osteophytes) :]
    for site, arises, factor in zip(MARGINS, course.arises_years, bare, strict=True):
        size_mm = min(law.most_mm, (years - arises) * course.growth_mm * factor)
        if size_mm >= law.least_mm and all(one.site != site for one in knee.osteophytes):
            grown.append(Osteophyte(site=site, size_mm=round(float(size_mm), 4)))
    return tuple(grown)


def _risen(value: float, rise: float, most: float) -> float:
    """No higher than `most`, unless it was."""
    return round(max(value, min(most, value + rise)), 4)


def _stage(knee: Knee, step: Step, cuts: OarsiCuts, definite_mm: float) -> int:
    """The KL grade of what a knee is built with, where an osteophyte of such a size is definite."""
    largest = largest_osteophyte_mm(knee)
    if largest < definite_mm:
        return int(largest >= step.doubtful_mm)
    lost = max(narrowed(knee, side, cuts) for side in SIDES)
    return 2 + sum(lost >= cut for cut in cuts.kellgren_lawrence.lost)


def _space_mm(knee: Knee, side: str) -> float:
    return float(getattr(knee, f"jsw_{side}_mm"))


def _held(value: float, law: FieldLaw) -> float:
    """A value, or the end of its field's range that it is beyond."""
    bounds = law.range
    assert bounds is not None
    return round(min(max(value, bounds[0]), bounds[1]), 4)
