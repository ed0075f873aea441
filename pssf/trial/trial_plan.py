"""Plan of a virtual trial: the subjects with their course, and the radiographs of every visit."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..core.checks import InputError
from ..core.random_streams import make_stream
from ..data.analysis.trial_table import Site, Treatment, TrialDesign
from ..model.knee import Knee
from ..model.progression import progress
from ..model.protocol import Protocol
from ..model.sampling.acquisition import sample_acquisition
from ..model.sampling.knee_sampling import KneeDistributions, sample_knee_from_distributions, sample_shared_fields
from .trial_design import CAUSES

# Keys of the random streams; a stream is identified by the key and by numbers.
_BODY, _KNEE, _COURSE, _ARM, _SITE, _DROPOUT, _ACQUISITION, _NOISE, READING_KEY = range(9)
# Number of attempts to sample a body with the required body mass index.
_ATTEMPTS = 1000
# Fields whose deviation from the nominal value depends on the care of a site.
_POSITIONING_FIELDS = tuple(
    name for cause in ("beam", "rotation", "flexion", "magnification") for name in CAUSES[cause]
)


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Subject of a trial.

    Attributes
    ----------
    number : int
        Number of the subject, from 0.
    treated : bool
        Whether the subject is in the treated arm.
    site : Site
        Imaging site.
    knees : tuple of Knee
        One knee or both knees at the first visit.
    last_month : float
        Time at which the subject leaves the trial, in months; infinite without drop-out.
    """

    number: int
    treated: bool
    site: Site
    knees: tuple[Knee, ...]
    last_month: float


@dataclass(frozen=True, kw_only=True)
class PlannedRadiograph:
    """Radiograph of one knee at one visit.

    Attributes
    ----------
    knee : Knee
        Knee at the visit.
    protocol : Protocol
        Sampled acquisition.
    labels : mapping of str to object
        Subject, knee, site, arm, month, view, repeat and cause that is left out.
    noise_seed : int
        Seed of the quantum noise.
    reading_key : tuple of int
        Key of the random stream of the human reader.
    """

    knee: Knee
    protocol: Protocol
    labels: Mapping[str, Any]
    noise_seed: int
    reading_key: tuple[int, ...] = field(default=())


def plan_subject(design: TrialDesign, distributions: KneeDistributions, number: int) -> Subject:
    """Sample a subject.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    distributions : KneeDistributions
        Distributions of the grade table of the design.
    number : int
        Number of the subject, from 0.

    Returns
    -------
    Subject
        Subject; the same for any number of subjects.

    Raises
    ------
    InputError
        If no body with the required body mass index is sampled, or the table does not contain a grade.
    """
    rng = make_stream(design.seed, _BODY, number)
    people = design.population
    weights = np.array(people.shares) / sum(people.shares)
    grade = int(rng.choice(people.grades, p=weights))
    sex = "female" if rng.random() < people.female else "male"
    shared = _sample_body(design, distributions, grade, sex, rng)
    sides = ("right", "left") if rng.random() < 0.5 else ("left", "right")
    knees = tuple(
        sample_knee_from_distributions(
            distributions, grade=grade, rng=make_stream(design.seed, _KNEE, number, turn), **shared, side=side
        )
        for turn, side in enumerate(sides[: people.knees])
    )
    shares = np.array([site.share for site in design.sites])
    place = int(make_stream(design.seed, _SITE, number).choice(len(shares), p=shares / shares.sum()))
    return Subject(
        number=number,
        treated=_is_treated(design, number),
        site=design.sites[place],
        knees=knees,
        last_month=_sample_last_month(design, number),
    )


def _sample_body(
    design: TrialDesign, distributions: KneeDistributions, grade: int, sex: str, rng: np.random.Generator
) -> dict[str, Any]:
    """Sample the fields that both knees share, with a body mass index within the range of the design."""
    low, high = design.population.bmi
    for _ in range(_ATTEMPTS):
        shared = sample_shared_fields(distributions, grade=grade, rng=rng, sex=sex)
        if low <= shared["bmi"] <= high:
            return shared
    raise InputError(f"population bmi must be a range that occurs in the population, got {low:g} to {high:g} kg/m2")


def _is_treated(design: TrialDesign, number: int) -> bool:
    """Assign a subject to an arm at random, so that each block of four has the share of treated subjects."""
    block, place = divmod(number, 4)
    order = make_stream(design.seed, _ARM, block).permutation(4)
    treated = design.treatment.treated
    # Whole blocks have floor(4 (block + 1) share) - floor(4 block share) treated subjects.
    count = int(np.floor(4 * (block + 1) * treated + 1e-9) - np.floor(4 * block * treated + 1e-9))
    return bool(order[place] < count)


def _sample_last_month(design: TrialDesign, number: int) -> float:
    """Sample the time at which a subject leaves the trial, in months."""
    rate = -np.log1p(-design.dropout.per_year) / 12
    drawn = make_stream(design.seed, _DROPOUT, number).exponential()
    return float(drawn / rate) if rate > 0 else float("inf")


def find_knee_at(subject: Subject, turn: int, month: float, design: TrialDesign) -> Knee:
    """Find a knee of a subject at a visit, with the natural course or the treated course.

    Parameters
    ----------
    subject : Subject
        Subject.
    turn : int
        Number of the knee, 0 or 1.
    month : float
        Time of the visit, in months.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    Knee
        Knee at the visit.
    """
    first = subject.knees[turn]
    if month == 0:
        return first
    later = progress(first, month / 12, rng=make_stream(design.seed, _COURSE, subject.number, turn))
    return slow_narrowing(first, later, design.treatment) if subject.treated else later


def slow_narrowing(first: Knee, later: Knee, treatment: Treatment) -> Knee:
    """Restore the fraction of the lost joint space that a treatment prevents; varus changes in proportion.

    Parameters
    ----------
    first, later : Knee
        Knee at the first visit, and with the natural course at a later visit.
    treatment : Treatment
        Fraction and compartment.

    Returns
    -------
    Knee
        Treated knee at the later visit.
    """
    slowed = ("medial", "lateral") if treatment.compartment == "both" else (treatment.compartment,)
    names = [f"jsw_{side}_mm" for side in ("medial", "lateral")]
    lost = np.array([getattr(first, name) - getattr(later, name) for name in names])
    kept = np.array([1 - treatment.fraction if side in slowed else 1.0 for side in ("medial", "lateral")])
    treated = lost * kept
    # The leg tilts in proportion to the difference of the losses.
    before = lost[0] - lost[1]
    share = (treated[0] - treated[1]) / before if before else 0.0
    varus = first.varus_deg + share * (later.varus_deg - first.varus_deg)
    changed: dict[str, Any] = {
        name: round(getattr(first, name) - loss, 4) for name, loss in zip(names, treated.tolist(), strict=True)
    }
    return replace(later, **changed, varus_deg=round(varus, 4), grade=None, reader_grade=None)


def plan_radiographs(
    design: TrialDesign, views: Mapping[str, Protocol], subject: Subject, *, without: str = ""
) -> list[PlannedRadiograph]:
    """Plan the radiographs of a subject.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    views : mapping of str to Protocol
        Nominal protocol of each view.
    subject : Subject
        Subject.
    without : str
        Cause of error that is left out; then only the first visit is planned. Empty: no cause.

    Returns
    -------
    list of PlannedRadiograph
        Radiographs in the order of knee, visit, view and repeat.
    """
    planned = []
    months = design.visits_months[:1] if without else design.visits_months
    for turn in range(len(subject.knees)):
        for visit, month in enumerate(months):
            if month > subject.last_month:
                continue
            knee = find_knee_at(subject, turn, month, design)
            for place, (view, nominal) in enumerate(views.items()):
                for repeat in range(1 if visit else design.repeats):
                    key = (subject.number, turn, visit, place, repeat)
                    labels = {
                        "subject": subject.number, "knee": turn, "side": knee.side, "site": subject.site.name,
                        "treated": subject.treated, "grade": subject.knees[turn].grade, "month": month,
                        "view": view, "repeat": repeat, "without": without,
                    }  # fmt: skip
                    planned.append(
                        PlannedRadiograph(
                            knee=knee,
                            protocol=_sample_protocol(design, subject.site, nominal, knee, key, without),
                            labels=labels,
                            noise_seed=int(make_stream(design.seed, _NOISE, *key).integers(2**63)),
                            reading_key=(READING_KEY, *key),
                        )
                    )
    return planned


def _sample_protocol(
    design: TrialDesign, site: Site, nominal: Protocol, knee: Knee, key: tuple[int, ...], cause: str
) -> Protocol:
    """Sample the acquisition of a radiograph at a site, without one cause of error."""
    drawn = sample_acquisition(nominal, rng=make_stream(design.seed, _ACQUISITION, *key), side=knee.side)
    changed: dict[str, Any] = {
        name: round(getattr(nominal, name) + site.positioning * (getattr(drawn, name) - getattr(nominal, name)), 3)
        for name in _POSITIONING_FIELDS
    }
    changed["beam_angle_deg"] = round(changed["beam_angle_deg"] + site.beam_offset_deg, 3)
    changed |= {name: getattr(nominal, name) for name in CAUSES.get(cause, ())}
    if cause == "noise":
        changed["noise"] = "none"
    if site.detector:
        changed["detector"] = site.detector
    return replace(drawn, **changed)
