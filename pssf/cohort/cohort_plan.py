"""Plan a cohort: sample its subjects, knees and radiographs from a seed, before anything is simulated."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

from ..core.checks import (
    InputError,
    require_choice,
    require_integer,
    require_seed,
)
from ..data.knees.grade_tables import list_tables_with_grade
from ..data.knees.preset_table import CohortPreset, load_presets
from ..model.field_listing import apply_settings, parse_settings
from ..model.knee import Knee, knee_to_dict
from ..model.protocol import Protocol, load_protocol, protocol_to_dict
from ..model.sampling.acquisition import sample_acquisition
from ..model.sampling.knee_sampling import (
    KneeDistributions,
    load_knee_distributions,
    sample_knee_from_distributions,
    sample_shared_fields,
)

# Keys of the random streams under the seed of a cohort. The index of the knee comes before the key, so that the order
# of making changes nothing. Key 4 belongs to `retest_plan`, key 6 to the response curves of the study.
# Stream of the knee's parameters.
_SHAPE = 0
# Stream of the noise seeds.
_NOISE = 3
# Stream of the acquisition variability.
_TAKING = 5
# Stream of the fields that both knees of a subject share.
_BODY = 2**31
# Stream of the random numbering of subjects.
_NUMBERS = 2**31 + 1
# Stream of the random selection of subjects.
_SOME = 2**31 + 2
# Former name of a preset -> present name.
_FORMER_PRESET_NAMES = {"people": "population"}


@dataclass(frozen=True)
class Exposure:
    """One radiograph to be made.

    Attributes
    ----------
    name : str
        Name of the radiograph and of its file.
    protocol : Protocol
        Protocol, with sampled acquisition variability if the preset asks for it.
    seed : int
        Seed of its noise.
    retest_kind : {"", "noise", "perturbation"}
        What differs from the first radiograph: the noise, or the positioning. "" if it is no repetition.
    repeat_index : int
        1 or 2, number of the repetition of its kind; 0 if it is no repetition.
    source_knee : int or None
        Index in the cohort of the knee that is imaged again; None if it is no repetition.
    """

    name: str
    protocol: Protocol
    seed: int
    retest_kind: str = ""
    repeat_index: int = 0
    source_knee: int | None = None


@dataclass(frozen=True)
class Case:
    """One knee of a subject, and the radiographs to be made of it.

    Attributes
    ----------
    subject : int
        Number of the subject.
    index : int
        Index of the knee in the cohort.
    knee : Knee
        Parameters of the knee.
    exposures : tuple of Exposure
        Radiographs to be made.
    grade_table : str
        Name or path of the grade table that the knee was sampled from.
    """

    subject: int
    index: int
    knee: Knee
    exposures: tuple[Exposure, ...]
    grade_table: str


@dataclass(frozen=True)
class Plan:
    """Cohort before it is made.

    Attributes
    ----------
    preset : str
        Name of the preset.
    seed : int
        Seed of the cohort.
    repeats : int
        Number of random splits of the subjects in a study.
    cases : tuple of Case
        Knees with their radiographs.
    retested : int
        Number of knees that are imaged again (`retest_plan.plan_retest`).
    masks : {"none", "tif"}
        Whether the masks of every radiograph are saved too.
    """

    preset: str
    seed: int
    repeats: int
    cases: tuple[Case, ...]
    retested: int = 0
    masks: str = "none"

    def build_request(self) -> dict[str, Any]:
        """Collect everything that determines the pixels of the cohort.

        Returns
        -------
        dict of str to object
            JSON-ready content of cohort.json.
        """
        protocols = dict.fromkeys(exposure.protocol for case in self.cases for exposure in case.exposures)
        return {
            "preset": self.preset,
            "seed": self.seed,
            "masks": self.masks,
            "protocols": [protocol_to_dict(protocol) for protocol in protocols],
            "knees": [_describe_case(case) for case in self.cases],
        }


def _describe_case(case: Case) -> dict[str, Any]:
    """List the subject, index, radiograph names and knee parameters of a case for cohort.json."""
    names = [exposure.name for exposure in case.exposures]
    asked = {"subject": case.subject, "index": case.index, "radiographs": names}
    return {**asked, **knee_to_dict(case.knee)}


def preset_names() -> list[str]:
    """List the names of the cohort presets of the package.

    Returns
    -------
    list of str
        Names.
    """
    return list(load_presets())


def plan_cohort(preset: str, *, seed: int, overrides: Mapping[str, Any] | None = None, masks: str = "none") -> Plan:
    """Plan a cohort: sample its subjects, their knees and the protocol of every radiograph.

    Subjects and knees are numbered at random under the seed, so that no number and no file name predicts a grade.

    Parameters
    ----------
    preset : str
        Name of a preset in ``data/presets.toml``.
    seed : int
        Seed, 0 to 2**63 - 1.
    overrides : mapping of str to object, optional
        Entries that replace those of the preset, such as ``{"knees": [2, 2, 2]}``, ``{"protocols": ["reference"]}``,
        ``{"matrix": 512}`` or ``{"settings": ["mas=3"]}``.
    masks : {"none", "tif"}, default "none"
        "tif" saves the masks of every radiograph too.

    Returns
    -------
    Plan
        The plan.

    Raises
    ------
    InputError
        If a preset, entry or protocol is unknown, or counts do not fit together.

    Warns
    -----
    DeprecationWarning
        If a former name of a preset or of an entry is used.

    Notes
    -----
    Both knees of a subject share one body and one grade: sex, stature, age, size and shape of the bones, height of
    fibula and patella, fabella, cortex, limb and fat. Joint space, alignment, osteophytes, pose and trabeculae are
    sampled for each knee separately. In patients these correlate within a grade too. The published ranges do not report
    by how much, so no value is assumed.
    """
    preset = _resolve_preset_name(preset)
    require_choice("preset", preset, preset_names())
    require_choice("masks", masks, ("none", "tif"))
    require_seed(seed)
    known = load_presets()[preset]
    given = _resolve_entry_names(overrides or {})
    for name in given:
        require_choice("preset entry", name, known.__struct_fields__)
    chosen = structs.replace(known, **given)
    require_choice("acquisition", chosen.acquisition, ("fixed", "sampled"))
    _, of_protocol = parse_settings(chosen.settings)
    meant = [_resample(apply_settings(load_protocol(name), of_protocol), chosen.matrix) for name in chosen.protocols]
    protocols = [taken for protocol in meant for taken in _make_variants(protocol, chosen)]
    names = [protocol.name for protocol in protocols]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"protocols must be one or more names, each once, got {', '.join(names) or 'none'}")
    for protocol in protocols:
        if protocol.knee_distance_mm:
            raise InputError(f"protocols must image one knee, got {protocol.name}, which images two")
    cases = []
    laws = load_knee_distributions(chosen.grade_table)
    _require_grades(chosen, laws, {grade: list_tables_with_grade(grade) for grade in range(len(chosen.knees))})
    for index, (subject, grade, side) in enumerate(_assign_subjects(chosen.knees, chosen.bilateral)):
        cases.append(_sample_case(_KneeSlot(seed, index, subject, grade, side), protocols, chosen, laws))
    cases = _renumber_subjects(cases, seed)
    require_integer("retested", chosen.retested, 0, 100_000, "knees")
    return Plan(
        preset=preset, seed=seed, repeats=chosen.repeats, cases=tuple(cases), retested=chosen.retested, masks=masks
    )


def _resolve_preset_name(preset: str) -> str:
    """Return the present name of a preset; warn if a former one is given."""
    if preset not in _FORMER_PRESET_NAMES:
        return preset
    said = (
        f"preset {preset!r} is now {_FORMER_PRESET_NAMES[preset]!r}; the former name will be removed; "
        "use the present name"
    )
    warnings.warn(said, DeprecationWarning, stacklevel=3)
    return _FORMER_PRESET_NAMES[preset]


def _resolve_entry_names(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries of a preset under their present names; warn if a former one is given."""
    if "grades" not in given:
        return dict(given)
    warnings.warn(
        "preset entry grades is now grade_table; the former name will be removed; use grade_table",
        DeprecationWarning,
        3,
    )
    return {"grade_table" if name == "grades" else name: value for name, value in given.items()}


def _require_grades(
    preset: CohortPreset, distributions: KneeDistributions, tables_by_grade: Mapping[int, Sequence[str]]
) -> None:
    """Check that the grade table has all requested grades; the error names the package's tables that have them."""
    beyond = [grade for grade, count in enumerate(preset.knees) if count and grade not in distributions.grades.grades]
    if not beyond:
        return
    others = ", ".join(tables_by_grade[beyond[0]])
    hint = f": grade table {others} has grade {beyond[0]}" if others else ""
    allowed = ", ".join(map(str, distributions.grades.grades))
    raise InputError(
        f"knees must be of grades {allowed} with grade table {distributions.table}, "
        f"got knees of grade {beyond[0]}{hint}"
    )


def _renumber_subjects(cases: Sequence[Case], seed: int) -> list[Case]:
    """Number the subjects at random; knees and images stay the same and follow the new order."""
    subjects = list(dict.fromkeys(case.subject for case in cases))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_NUMBERS,)))
    number = dict(zip(subjects, rng.permutation(len(subjects)).tolist(), strict=True))
    ordered = sorted(cases, key=lambda case: number[case.subject])
    return [_rename_case(case, number[case.subject], index) for index, case in enumerate(ordered)]


def _rename_case(case: Case, subject: int, index: int) -> Case:
    """Give a case new numbers of subject and knee, also in the names of its radiographs."""
    before, now = radiograph_stem(case.subject, case.index), radiograph_stem(subject, index)
    exposures = tuple(replace(taken, name=now + taken.name.removeprefix(before)) for taken in case.exposures)
    return replace(case, subject=subject, index=index, exposures=exposures)


def radiograph_stem(subject: int, index: int) -> str:
    """Build the beginning of the names of a knee's radiographs.

    Parameters
    ----------
    subject : int
        Number of the subject.
    index : int
        Index of the knee.

    Returns
    -------
    str
        Text such as "s0012_k0015".
    """
    return f"s{subject:04d}_k{index:04d}"


def select_subjects(plan: Plan, people: int) -> Plan:
    """Select subjects of a plan at random under its seed, equally many per grade; their images stay the same.

    A smaller selection is part of every larger one.

    Parameters
    ----------
    plan : Plan
        Whole cohort.
    people : int
        Number of subjects in all, a multiple of the number of grades.

    Returns
    -------
    Plan
        Plan with the selected subjects.

    Raises
    ------
    InputError
        If `people` is no multiple of the number of grades, or exceeds what the plan has.
    """
    of_grade: dict[int | None, dict[int, None]] = {}
    for case in plan.cases:
        of_grade.setdefault(case.knee.grade, {})[case.subject] = None
    each, rest = divmod(people, len(of_grade))
    most = min(map(len, of_grade.values()))
    if rest or not 1 <= each <= most:
        raise InputError(
            f"people must be a multiple of {len(of_grade)}, the number of grades, up to {most * len(of_grade)}, "
            f"got {people}"
        )
    rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(_SOME,)))
    chosen = {subject for whole in of_grade.values() for subject in rng.permutation(list(whole))[:each].tolist()}
    return replace(plan, cases=tuple(case for case in plan.cases if case.subject in chosen))


def _assign_subjects(knees: Sequence[int], bilateral: int) -> list[tuple[int, int, str | None]]:
    """Assign subject, grade and side to every knee; bilateral subjects come from each grade in proportion."""
    for grade, count in enumerate(knees):
        require_integer(f"knees of grade {grade}", count, 0, 100_000, "")
    total = sum(knees)
    require_integer("bilateral", bilateral, 0, total // 2, "subjects")
    if total == 0:
        raise InputError("knees must sum to 1 or more, got sum(knees) = 0")
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


def _resample(protocol: Protocol, matrix: int) -> Protocol:
    """Change the number of pixels of a protocol; 0 leaves it unchanged."""
    return protocol.resample(matrix) if matrix else protocol


def _make_variants(protocol: Protocol, preset: CohortPreset) -> list[Protocol]:
    """Make the protocol at every tilt and, within one tilt, at every dose.

    Variants of one geometry follow each other, so that they can share their path lengths.
    """
    variants = []
    for tilt_deg in preset.tilts_deg:
        for dose in preset.doses:
            angle_deg, mas = protocol.beam_angle_deg + tilt_deg, round(protocol.mas * dose, 4)
            tilted = f"_beam{angle_deg:g}" if tilt_deg else ""
            name = f"{protocol.name}{tilted}" + (f"_dose{100 * dose:g}" if dose != 1 else "")
            variants.append(replace(protocol, name=name, mas=mas, beam_angle_deg=angle_deg))
    return variants


class _KneeSlot(NamedTuple):
    """Place of one knee in a cohort: subject, grade and side; a side of None is sampled."""

    seed: int
    knee_index: int
    subject: int
    grade: int
    side: str | None


def _sample_case(
    slot: _KneeSlot, protocols: list[Protocol], preset: CohortPreset, distributions: KneeDistributions
) -> Case:
    """Sample the knee of a slot and the protocol and noise seed of each of its radiographs."""
    seed, number, subject, grade, side = slot
    fixed = dict(_sample_subject_fields(seed, subject, grade, distributions))
    if side is not None:
        fixed["side"] = side
    shape = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, _SHAPE)))
    of_knee, of_protocol = parse_settings(preset.settings)
    knee = apply_settings(sample_knee_from_distributions(distributions, grade=grade, rng=shape, **fixed), of_knee)
    exposures = []
    for turn, protocol in enumerate(protocols):
        state = np.random.SeedSequence(seed, spawn_key=(number, _NOISE, turn)).generate_state(1, np.uint64)
        name = f"{radiograph_stem(subject, number)}_{protocol.name}"
        if preset.acquisition == "sampled":
            taking = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, _TAKING, turn)))
            set_to = {field: getattr(protocol, field) for field in of_protocol}
            protocol = replace(sample_acquisition(protocol, rng=taking, side=knee.side), **set_to)
        exposures.append(Exposure(name, protocol, int(state[0] >> np.uint64(1))))
    return Case(subject=subject, index=number, knee=knee, exposures=tuple(exposures), grade_table=preset.grade_table)


@lru_cache(maxsize=1)  # The other knee of a subject follows directly.
def _sample_subject_fields(seed: int, subject: int, grade: int, distributions: KneeDistributions) -> Mapping[str, Any]:
    """Sample the fields that the knees of a subject share, from a stream of the subject's own."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BODY, subject)))
    return sample_shared_fields(distributions, grade=grade, rng=rng)
