"""Who is in a cohort and how each knee is taken; drawn from a seed, made later."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

from ..core.checks import InputError, require_choice, require_seed, require_whole
from ..data.grade_tables import tables_with
from ..data.presets import Preset, presets
from ..model.draw import DrawLaws, draw_body, draw_laws, drawn_knee
from ..model.exposure import draw_exposure
from ..model.knee import Knee, knee_table
from ..model.listing import changes, with_changes
from ..model.protocol import Protocol, load_protocol, protocol_table

# Keys of the streams under a cohort's seed. A knee's index stands first, so the order of making changes nothing.
# 4 is that of `retest`, 6 that of the study's curves.
_SHAPE, _NOISE, _TAKING, _BODY, _NUMBERS, _SOME = 0, 3, 5, 2**31, 2**31 + 1, 2**31 + 2
# Earlier name of a preset -> its name.
_EARLIER = {"people": "population"}


@dataclass(frozen=True)
class Exposure:
    """One radiograph to be made.

    seed     of its noise
    kind     of a radiograph taken again: what is other than the first time, noise | perturbation; else ""
    turn     1 or 2 of its kind; else 0
    of_knee  index in the plan of the knee that is taken again; else None
    """

    name: str
    protocol: Protocol
    seed: int
    kind: str = ""
    turn: int = 0
    of_knee: int | None = None


@dataclass(frozen=True)
class Case:
    """One knee of a subject, and the radiographs to be made of it.

    grade_table  name or path of the table that it was sampled from
    """

    subject: int
    index: int
    knee: Knee
    exposures: tuple[Exposure, ...]
    grade_table: str


@dataclass(frozen=True)
class Plan:
    """A cohort before it is made.

    repeats   splits of its subjects
    retested  knees that are taken again, see `retest.plan_retest`
    masks     "tif": each radiograph's are written as well; "none"
    """

    preset: str
    seed: int
    repeats: int
    cases: tuple[Case, ...]
    retested: int = 0
    masks: str = "none"

    def table(self) -> dict[str, Any]:
        """All that decides the pixels of this cohort, JSON-ready."""
        protocols = dict.fromkeys(exposure.protocol for case in self.cases for exposure in case.exposures)
        return {
            "preset": self.preset,
            "seed": self.seed,
            "masks": self.masks,
            "protocols": [protocol_table(protocol) for protocol in protocols],
            "knees": [_asked(case) for case in self.cases],
        }


def _asked(case: Case) -> dict[str, Any]:
    names = [exposure.name for exposure in case.exposures]
    asked = {"subject": case.subject, "index": case.index, "radiographs": names}
    return {**asked, **knee_table(case.knee)}


def preset_names() -> list[str]:
    """Names of the cohorts that come with the package."""
    return list(presets())


def plan_cohort(preset: str, *, seed: int, overrides: Mapping[str, Any] | None = None, masks: str = "none") -> Plan:
    """Draw a cohort.

    Both knees of a subject have one body (sex, stature, size and shape of bones, height of fibula and patella, fabella,
    cortex, limb, fat, age) and one grade. Given these, joint space, alignment, osteophytes, pose and trabeculae are
    drawn for each knee apart: they are alike by their grade alone. In people they correlate within a grade too; the
    ranges that are drawn from do not say by how much, and a number of our own is not put in their place.

    preset     a name of `data/presets.toml`
    Subjects and knees are numbered at random under the seed, so that no number and no file name predicts a grade.

    overrides  entries that replace the preset's, such as {"knees": [2, 2, 2]}, {"protocols": ["reference"]},
               {"matrix": 512} or {"settings": ["mas=3"]}
    masks      "tif" to have the masks of every radiograph written as well, or "none"
    raises     InputError for an unknown preset, entry or protocol, or counts that do not fit
    """
    preset = _named_now(preset)
    require_choice("preset", preset, preset_names())
    require_choice("masks", masks, ("none", "tif"))
    require_seed(seed)
    known = presets()[preset]
    given = _entries_now(overrides or {})
    for name in given:
        require_choice("preset entry", name, known.__struct_fields__)
    chosen = structs.replace(known, **given)
    require_choice("exposures", chosen.exposures, ("fixed", "drawn"))
    _, of_protocol = changes(chosen.settings)
    meant = [_resampled(with_changes(load_protocol(name), of_protocol), chosen.matrix) for name in chosen.protocols]
    protocols = [taken for protocol in meant for taken in _variants(protocol, chosen)]
    names = [protocol.name for protocol in protocols]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"protocols = {', '.join(names) or 'none'}; allowed: one or more, each once")
    for protocol in protocols:
        if protocol.apart_mm:
            raise InputError(f"protocols = {protocol.name}, of two knees at once; allowed: those of one knee")
    cases = []
    laws = draw_laws(chosen.grade_table)
    _require_grades(chosen, laws, {grade: tables_with(grade) for grade in range(len(chosen.knees))})
    for index, (subject, grade, side) in enumerate(_people(chosen.knees, chosen.bilateral)):
        cases.append(_case(_Place(seed, index, subject, grade, side), protocols, chosen, laws))
    cases = _renumbered(cases, seed)
    require_whole("retested", chosen.retested, 0, 100_000, "knees")
    return Plan(
        preset=preset, seed=seed, repeats=chosen.repeats, cases=tuple(cases), retested=chosen.retested, masks=masks
    )


def _named_now(preset: str) -> str:
    if preset not in _EARLIER:
        return preset
    said = f"preset {preset!r} is now {_EARLIER[preset]!r}; the earlier name will be removed"
    warnings.warn(said, DeprecationWarning, stacklevel=3)
    return _EARLIER[preset]


def _entries_now(given: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of a preset under their names of now."""
    if "grades" not in given:
        return dict(given)
    warnings.warn("preset entry grades is now grade_table; the earlier name will be removed", DeprecationWarning, 3)
    return {"grade_table" if name == "grades" else name: value for name, value in given.items()}


def _require_grades(chosen: Preset, laws: DrawLaws, having: Mapping[int, Sequence[str]]) -> None:
    """Refuse counts of grades that the table lacks; having: grade -> tables of the package that have it."""
    beyond = [grade for grade, count in enumerate(chosen.knees) if count and grade not in laws.grades.grades]
    if not beyond:
        return
    others = ", ".join(having[beyond[0]])
    hint = f": grade table {others} has grade {beyond[0]}" if others else ""
    allowed = ", ".join(map(str, laws.grades.grades))
    raise InputError(
        f"knees must be of grades {allowed} with grade table {laws.table}, got knees of grade {beyond[0]}{hint}"
    )


def _renumbered(cases: Sequence[Case], seed: int) -> list[Case]:
    """Number the subjects at random: the same knees and images, in the order of the new numbers."""
    subjects = list(dict.fromkeys(case.subject for case in cases))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_NUMBERS,)))
    number = dict(zip(subjects, rng.permutation(len(subjects)).tolist(), strict=True))
    ordered = sorted(cases, key=lambda case: number[case.subject])
    return [_named(case, number[case.subject], index) for index, case in enumerate(ordered)]


def _named(case: Case, subject: int, index: int) -> Case:
    before, now = stem(case.subject, case.index), stem(subject, index)
    exposures = tuple(replace(taken, name=now + taken.name.removeprefix(before)) for taken in case.exposures)
    return replace(case, subject=subject, index=index, exposures=exposures)


def stem(subject: int, index: int) -> str:
    """What the names of a knee's radiographs begin with."""
    return f"s{subject:04d}_k{index:04d}"


def some_people(plan: Plan, people: int) -> Plan:
    """People of a plan, chosen by chance under its seed, with their images as they are in the whole.

    people  in all; of each grade as many; fewer of them are among more
    raises  InputError for more than there are, or a number that is no multiple of the number of grades
    """
    of_grade: dict[int | None, dict[int, None]] = {}
    for case in plan.cases:
        of_grade.setdefault(case.knee.grade, {})[case.subject] = None
    each, rest = divmod(people, len(of_grade))
    most = min(map(len, of_grade.values()))
    if rest or not 1 <= each <= most:
        raise InputError(f"people = {people}; allowed: a multiple of {len(of_grade)} grades, to {most * len(of_grade)}")
    rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(_SOME,)))
    chosen = {subject for whole in of_grade.values() for subject in rng.permutation(list(whole))[:each].tolist()}
    return replace(plan, cases=tuple(case for case in plan.cases if case.subject in chosen))


def _people(knees: Sequence[int], bilateral: int) -> list[tuple[int, int, str | None]]:
    """Subject, grade and side of every knee; pairs come from each grade in proportion."""
    for grade, count in enumerate(knees):
        require_whole(f"knees of grade {grade}", count, 0, 100_000, "")
    total = sum(knees)
    require_whole("bilateral", bilateral, 0, total // 2, "subjects")
    if total == 0:
        raise InputError("knees = 0; allowed: 1 or more")
    pairs = [int(count * bilateral / total) for count in knees]
    for grade in sorted(range(len(knees)), key=lambda g: pairs[g] - knees[g] * bilateral / total):
        if sum(pairs) < bilateral and 2 * (pairs[grade] + 1) <= knees[grade]:
            pairs[grade] += 1
    people: list[tuple[int, int, str | None]] = []
    subject = 0
    for grade, count in enumerate(knees):
        for _ in range(pairs[grade]):
            people += [(subject, grade, "right"), (subject, grade, "left")]
            subject += 1
        for _ in range(count - 2 * pairs[grade]):
            people.append((subject, grade, None))
            subject += 1
    return people


def _resampled(protocol: Protocol, matrix: int) -> Protocol:
    return protocol.resampled(matrix) if matrix else protocol


def _variants(protocol: Protocol, preset: Preset) -> list[Protocol]:
    """The protocol at every tilt and, within one, at every dose, so that those of one geometry follow each other."""
    variants = []
    for tilt_deg in preset.tilts_deg:
        for dose in preset.doses:
            angle_deg, mas = protocol.beam_angle_deg + tilt_deg, round(protocol.mas * dose, 4)
            tilted = f"_beam{angle_deg:g}" if tilt_deg else ""
            name = f"{protocol.name}{tilted}" + (f"_dose{100 * dose:g}" if dose != 1 else "")
            variants.append(replace(protocol, name=name, mas=mas, beam_angle_deg=angle_deg))
    return variants


class _Place(NamedTuple):
    """One knee in a cohort: whose, of which grade and side, None where that is drawn."""

    seed: int
    number: int
    subject: int
    grade: int
    side: str | None


def _case(place: _Place, protocols: list[Protocol], preset: Preset, laws: DrawLaws) -> Case:
    seed, number, subject, grade, side = place
    fixed = dict(_body(seed, subject, grade, laws))
    if side is not None:
        fixed["side"] = side
    shape = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, _SHAPE)))
    of_knee, of_protocol = changes(preset.settings)
    knee = with_changes(drawn_knee(laws, grade=grade, rng=shape, **fixed), of_knee)
    exposures = []
    for turn, protocol in enumerate(protocols):
        state = np.random.SeedSequence(seed, spawn_key=(number, _NOISE, turn)).generate_state(1, np.uint64)
        name = f"{stem(subject, number)}_{protocol.name}"
        if preset.exposures == "drawn":
            taking = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, _TAKING, turn)))
            set_to = {field: getattr(protocol, field) for field in of_protocol}
            protocol = replace(draw_exposure(protocol, rng=taking, side=knee.side), **set_to)
        exposures.append(Exposure(name, protocol, int(state[0] >> np.uint64(1))))
    return Case(subject=subject, index=number, knee=knee, exposures=tuple(exposures), grade_table=preset.grade_table)


@lru_cache(maxsize=1)  # the other knee of a subject comes next
def _body(seed: int, subject: int, grade: int, laws: DrawLaws) -> Mapping[str, Any]:
    """The fields that the knees of a subject share, drawn from a stream of the subject's own."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BODY, subject)))
    return draw_body(laws, grade=grade, rng=rng)
