"""Simulate the progression of osteoarthritis in a knee, and compute the true change between two visits."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.checks import (
    Array,
    InputError,
    RNGLike,
    require_in_range,
    resolve_generator,
)
from ..core.keyword_arguments import check_keywords
from ..data.knees.field_definitions import FieldSpec, load_field_specs
from ..data.knees.oarsi_table import OarsiThresholds, load_oarsi_thresholds
from ..data.knees.progression_table import ProgressionRates, ProgressionThresholds, load_progression_rates
from ..data.table_records import Pair
from .kellgren_lawrence import (
    MARGINS,
    MAX_GRADE,
    SIDES,
    allowed_grades,
    largest_osteophyte_mm,
    narrowing_fraction,
)
from .knee import Knee, Osteophyte, other_compartment

# Longest time that `progress` simulates, in years.
_MAX_YEARS = 40
# Knee fields whose change `true_change` reports.
_CHANGING_FIELDS = (
    "jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg", "notch_growth_mm", "effusion_mm", "age_years",
)  # fmt: skip


@check_keywords()
def progress(knee: Knee, years: float, rng: RNGLike) -> Knee:
    """Simulate the progression of osteoarthritis in a knee over a number of years, without improvement.

    No joint space becomes wider and no osteophyte becomes smaller. Bone shape, size, pose, limb, cysts and texture seed
    do not change. The annual rates depend on the seed and not on `years`. Calls with the same seed and different
    `years` therefore simulate several visits of one disease course.

    Parameters
    ----------
    knee : Knee
        Knee at the first visit.
    years : float
        Time since the first visit, 0 to 40 years.
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness.

    Returns
    -------
    Knee
        Knee at the later visit. `Knee.grade` is None if it is None at the first visit.

    Raises
    ------
    InputError
        If `knee` is not a Knee, `years` is out of range, the final age is out of range, or `rng` is neither an integer
        nor a Generator.

    Notes
    -----
    ``data/progress.toml`` contains the annual rates of each KL grade and their sources.

    Examples
    --------
    >>> import pssf
    >>> first = pssf.sample_knee(grade=2, rng=7)
    >>> pssf.progress(first, 2.0, rng=1).jsw_medial_mm <= first.jsw_medial_mm
    True
    """
    if not isinstance(knee, Knee):
        raise InputError(f"knee must be a Knee, got {knee!r}")
    rng = resolve_generator(rng)
    require_in_range("years", years, 0, _MAX_YEARS, "years")
    law, cuts, of_varus = load_progression_rates(), load_oarsi_thresholds(), load_field_specs("knee")["varus_deg"]
    definite_mm = law.step.definite_mm[MAX_GRADE if knee.grade is None else knee.grade]
    stage = _derive_structural_grade(knee, law.step, cuts, definite_mm)
    lost_already = {side: narrowing_fraction(knee, side, cuts) for side in SIDES}
    course = _sample_progression_rates(law, knee, stage if knee.grade is None else knee.grade, lost_already, rng)
    other = other_compartment(course.narrowing_side)
    loss_mm = years * course.jsw_loss_mm_per_year
    lost = {course.narrowing_side: loss_mm, other: loss_mm * law.other_compartment_fraction}
    spaces: dict[str, Any] = {
        f"jsw_{side}_mm": round(max(0.0, _jsw_mm(knee, side) - mm), 4) for side, mm in lost.items()
    }
    fell = {side: _jsw_mm(knee, side) - spaces[f"jsw_{side}_mm"] for side in SIDES}
    varus_deg = knee.varus_deg + law.varus_deg_per_mm * (fell["medial"] - fell["lateral"])
    later = replace(
        knee,
        **spaces,
        grade=None,
        osteophytes=_grow_osteophytes(knee, years, course, law),
        subchondral_plate=_increase_up_to(
            knee.subchondral_plate, years * course.plate_thickening_per_year, law.most_plate
        ),
        notch_growth_mm=_increase_up_to(
            knee.notch_growth_mm, years * course.notch_growth_mm_per_year, law.most_notch_mm
        ),
        effusion_mm=_increase_up_to(knee.effusion_mm, years * course.effusion_growth_mm_per_year, law.most_swelling_mm),
        varus_deg=_clip_to_range(varus_deg, of_varus),
        age_years=round(knee.age_years + years, 4),
    )
    if knee.grade is None:
        return later
    low, high = allowed_grades(later, cuts)
    stepped = knee.grade + _derive_structural_grade(later, law.step, cuts, definite_mm) - stage
    # The grade never decreases, because the model does not simulate improvement.
    grade = min(MAX_GRADE, max(knee.grade, low, min(stepped, high)))
    read = None if knee.reader_grade is None else min(MAX_GRADE, knee.reader_grade + grade - knee.grade)
    return replace(later, grade=grade, reader_grade=read)


def true_change(before: Knee, after: Knee) -> dict[str, float]:
    """Compute the true change of a knee between two visits.

    Parameters
    ----------
    before, after : Knee
        Knee at the first visit, and the same knee at the second visit.

    Returns
    -------
    dict of str to float
        Value at the second visit minus value at the first visit, keyed by field: joint space widths, subchondral bone
        plate, varus, notch growth, effusion and age. ``largest_osteophyte_mm`` and ``osteophyte_count`` are changes of
        all osteophytes. ``grade_change`` is the change of the KL grade if both knees have a grade.

    Raises
    ------
    InputError
        If an argument is not a Knee.

    Examples
    --------
    >>> import pssf
    >>> first = pssf.sample_knee(grade=2, rng=7)
    >>> pssf.true_change(first, pssf.progress(first, 2.0, rng=1))["age_years"]
    2.0
    """
    for called, knee in (("before", before), ("after", after)):
        if not isinstance(knee, Knee):
            raise InputError(f"{called} must be a Knee, got {knee!r}")
    change = {name: round(getattr(after, name) - getattr(before, name), 4) for name in _CHANGING_FIELDS}
    sizes = [[one.size_mm for one in knee.osteophytes] for knee in (before, after)]
    change["largest_osteophyte_mm"] = round(max(sizes[1], default=0.0) - max(sizes[0], default=0.0), 4)
    change["osteophyte_count"] = len(sizes[1]) - len(sizes[0])
    if before.grade is not None and after.grade is not None:
        change["grade_change"] = after.grade - before.grade
    return change


@dataclass(frozen=True)
class _ProgressionRates:
    """Sampled annual progression rates of one knee.

    `growth_factors` has shape (osteophytes + 4,): first one growth-rate factor per existing osteophyte, then one factor
    per joint margin. `onset_years` has shape (4,): the time at which a new osteophyte appears at each margin. The time
    is used only if the margin has no osteophyte at the first visit.
    """

    narrowing_side: str
    jsw_loss_mm_per_year: float
    osteophyte_growth_mm_per_year: float
    plate_thickening_per_year: float
    onset_years: Array
    growth_factors: Array
    notch_growth_mm_per_year: float
    effusion_growth_mm_per_year: float


def _sample_progression_rates(
    law: ProgressionRates, knee: Knee, grade: int, lost_fraction: dict[str, float], rng: np.random.Generator
) -> _ProgressionRates:
    """Sample the annual progression rates of a knee, which depend on the KL grade.

    `lost_fraction` is the fraction of the healthy joint space that each compartment has lost at the first visit. From
    the KL grade `narrowed_side_known_from_grade` on, the compartment with the greater loss continues to narrow.
    """
    drawn = "medial" if rng.random() < law.medial else "lateral"
    narrower = max(SIDES, key=lambda side: lost_fraction[side])
    loss, growth, plate = (_sample_gamma(of[grade], rng) for of in (law.loss_mm, law.osteophyte_mm, law.plate))
    return _ProgressionRates(
        narrowing_side=narrower if grade >= law.narrowed_side_known_from_grade else drawn,
        jsw_loss_mm_per_year=loss,
        osteophyte_growth_mm_per_year=growth,
        plate_thickening_per_year=plate,
        onset_years=rng.exponential(1 / law.new_osteophytes_per_year[grade], len(MARGINS)),
        growth_factors=rng.uniform(*law.growth_factor_range, len(knee.osteophytes) + len(MARGINS)),
        notch_growth_mm_per_year=_sample_gamma(law.notch_mm[grade], rng),
        effusion_growth_mm_per_year=_sample_gamma(law.swelling_mm[grade], rng),
    )


def _sample_gamma(law: Pair, rng: np.random.Generator) -> float:
    """Sample a gamma distribution that is specified by its mean and standard deviation."""
    mean, sd = law
    return float(rng.gamma((mean / sd) ** 2, sd**2 / mean))


def _grow_osteophytes(
    knee: Knee, years: float, course: _ProgressionRates, law: ProgressionRates
) -> tuple[Osteophyte, ...]:
    """Enlarge the existing osteophytes and add osteophytes that have appeared since the first visit."""
    grown = []
    for one, factor in zip(knee.osteophytes, course.growth_factors, strict=False):
        size_mm = min(law.most_mm, one.max_size_mm, one.size_mm + years * course.osteophyte_growth_mm_per_year * factor)
        grown.append(replace(one, size_mm=round(max(one.size_mm, float(size_mm)), 4)))
    bare = course.growth_factors[len(knee.osteophytes) :]
    for site, arises, factor in zip(MARGINS, course.onset_years, bare, strict=True):
        size_mm = min(law.most_mm, (years - arises) * course.osteophyte_growth_mm_per_year * factor)
        if size_mm >= law.least_mm and all(one.site != site for one in knee.osteophytes):
            grown.append(Osteophyte(site=site, size_mm=round(float(size_mm), 4)))
    return tuple(grown)


def _increase_up_to(value: float, increase: float, maximum: float) -> float:
    """Increase a value, but not above a maximum; do not change a value that already exceeds the maximum."""
    return round(max(value, min(maximum, value + increase)), 4)


def _derive_structural_grade(knee: Knee, step: ProgressionThresholds, cuts: OarsiThresholds, definite_mm: float) -> int:
    """Derive the KL grade of a knee; count osteophytes of at least `definite_mm` as definite."""
    largest = largest_osteophyte_mm(knee)
    if largest < definite_mm:
        return int(largest >= step.doubtful_mm)
    lost = max(narrowing_fraction(knee, side, cuts) for side in SIDES)
    return 2 + sum(lost >= cut for cut in cuts.kellgren_lawrence.jsw_loss_fractions)


def _jsw_mm(knee: Knee, side: str) -> float:
    """Return the joint space width of a compartment, in mm."""
    return float(getattr(knee, f"jsw_{side}_mm"))


def _clip_to_range(value: float, law: FieldSpec) -> float:
    """Clip a field value to the allowed range of the field."""
    bounds = law.range
    assert bounds is not None
    return round(min(max(value, bounds[0]), bounds[1]), 4)
