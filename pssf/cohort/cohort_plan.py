"""Plan a cohort: sample its subjects, knees and radiographs from a seed, before the simulation."""

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

# The following keys separate the random streams of one cohort seed. A stream of a single knee is identified by the knee
# index and the key, so results do not depend on the order of the knees. `retest_plan` uses key 4, and the response
# curves of the study use key 6.

# Key of the random stream of the knee parameters.
_SHAPE = 0
# Key of the random stream of the noise seeds.
_NOISE = 3
# Key of the random stream of the acquisition variability.
_ACQUISITION = 5
# Key of the random stream of the fields that both knees of a subject share.
_BODY = 2**31
# Key of the random stream of the subject numbers.
_NUMBERS = 2**31 + 1
# Key of the random stream of the subject selection.
_SOME = 2**31 + 2
# Current names of presets, keyed by former name.
_FORMER_PRESET_NAMES = {"people": "population"}


@dataclass(frozen=True)
class Exposure:
    """Plan of one radiograph.

    Attributes
    ----------
    name : str
        Name of the radiograph, which is also the stem of its file.
    protocol : Protocol
        Protocol of the radiograph; it includes sampled acquisition variability if the preset requests it.
    seed : int
        Seed of the noise.
    retest_kind : {"", "noise", "perturbation"}
        Difference from the first radiograph: "noise" for new noise only, "perturbation" for new positioning; "" if the
        radiograph is not a repeat.
    repeat_index : int
        Number of the repeat within its `retest_kind`, 1 or 2; 0 if the radiograph is not a repeat.
    source_knee : int or None
        Index of the knee that is imaged again; None if the radiograph is not a repeat.
    """

    name: str
    protocol: Protocol
    seed: int
    retest_kind: str = ""
    repeat_index: int = 0
    source_knee: int | None = None


@dataclass(frozen=True)
class Case:
    """Plan of one knee and its radiographs.

    Attributes
    ----------
    subject : int
        Number of the subject.
    index : int
        Index of the knee in the cohort.
    knee : Knee
        Parameters of the knee.
    exposures : tuple of Exposure
        Planned radiographs of the knee.
    grade_table : str
        Name or path of the grade table from which the knee was sampled.
    """

    subject: int
    index: int
    knee: Knee
    exposures: tuple[Exposure, ...]
    grade_table: str


@dataclass(frozen=True)
class Plan:
    """Plan of a cohort.

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
        File format of the segmentation masks of each radiograph; "none" saves no masks.
    definition : CohortPreset or None
        Preset after the replacement of entries; None if the plan was not made from a preset.
    """

    preset: str
    seed: int
    repeats: int
    cases: tuple[Case, ...]
    retested: int = 0
    masks: str = "none"
    definition: CohortPreset | None = None

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
        Names of the presets.
    """
    return list(load_presets())


def plan_cohort(preset: str, *, seed: int, overrides: Mapping[str, Any] | None = None, masks: str = "none") -> Plan:
    """Plan a cohort: sample its subjects, their knees and the protocol of every radiograph.

    Subjects and knees are numbered at random from the seed, so that numbers and file names do not predict grades.

    Parameters
    ----------
    preset : str
        Name of a preset in ``data/presets.toml``.
    seed : int
        Seed, 0 to 2**63 - 1.
    overrides : mapping of str to object, optional
        New values of preset entries, such as ``{"knees": [2, 2, 2]}``, ``{"protocols": ["reference"]}``,
        ``{"matrix": 512}`` or ``{"settings": ["mas=3"]}``.
    masks : {"none", "tif"}, default "none"
        File format of the segmentation masks of each radiograph; "none" saves no masks.

    Returns
    -------
    Plan
        Plan of the cohort.

    Raises
    ------
    InputError
        If a preset, entry or protocol is unknown, or the numbers of knees and subjects are inconsistent.

    Warns
    -----
    DeprecationWarning
        If a former name of a preset or of an entry is used.

    Notes
    -----
    Both knees of a subject share the grade and all properties of the body: sex, stature, age, bone size and shape,
    heights of fibula and patella, fabella, cortical thickness, limb size and fat thickness. Joint space, alignment,
    osteophytes, pose and trabeculae are sampled separately for each knee. In patients, the latter parameters also
    correlate between the two knees within a grade. The published ranges do not report this correlation, so no
    correlation is assumed.
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
        raise InputError(f"protocols must be one or more different names, got {', '.join(names) or 'none'}")
    for protocol in protocols:
        if protocol.knee_distance_mm:
            raise InputError(f"protocols must image one knee, got {protocol.name}, which images two knees")
    cases = []
    laws = load_knee_distributions(chosen.grade_table)
    _require_grades(chosen, laws, {grade: list_tables_with_grade(grade) for grade in range(len(chosen.knees))})
    for index, (subject, grade, side) in enumerate(_assign_subjects(chosen.knees, chosen.bilateral)):
        cases.append(_sample_case(_KneeSlot(seed, index, subject, grade, side), protocols, chosen, laws))
    cases = _renumber_subjects(cases, seed)
    require_integer("retested", chosen.retested, 0, 100_000, "knees")
    return Plan(
        preset=preset,
        seed=seed,
        repeats=chosen.repeats,
        cases=tuple(cases),
        retested=chosen.retested,
        masks=masks,
        definition=chosen,
    )


def _resolve_preset_name(preset: str) -> str:
    """Return the current name of a preset; warn if a former name is given."""
    if preset not in _FORMER_PRESET_NAMES:
        return preset
    said = (
        f"preset {preset!r} is now {_FORMER_PRESET_NAMES[preset]!r}, but the former name will be removed; "
        "use the current name"
    )
    warnings.warn(said, DeprecationWarning, stacklevel=3)
    return _FORMER_PRESET_NAMES[preset]


def _resolve_entry_names(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return preset entries under their current names; warn if a former name is given."""
    if "grades" not in given:
        return dict(given)
    warnings.warn(
        "preset entry grades is now grade_table, but the former name will be removed; use grade_table",
        DeprecationWarning,
        3,
    )
    return {"grade_table" if name == "grades" else name: value for name, value in given.items()}


def _require_grades(
    preset: CohortPreset, distributions: KneeDistributions, tables_by_grade: Mapping[int, Sequence[str]]
) -> None:
    """Require that the grade table defines all requested grades; the error lists tables that define them."""
    beyond = [grade for grade, count in enumerate(preset.knees) if count and grade not in distributions.grades.grades]
    if not beyond:
        return
    others = ", ".join(tables_by_grade[beyond[0]])
    hint = f": grade table {others} has grade {beyond[0]}" if others else ""
    allowed = ", ".join(map(str, distributions.grades.grades))
    raise InputError(
        f"knees must have grades {allowed} with grade table {distributions.table}, "
        f"got knees with grade {beyond[0]}{hint}"
    )


def _renumber_subjects(cases: Sequence[Case], seed: int) -> list[Case]:
    """Number the subjects at random and sort the cases by subject; knees and images do not change."""
    subjects = list(dict.fromkeys(case.subject for case in cases))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_NUMBERS,)))
    number = dict(zip(subjects, rng.permutation(len(subjects)).tolist(), strict=True))
    ordered = sorted(cases, key=lambda case: number[case.subject])
    return [_rename_case(case, number[case.subject], index) for index, case in enumerate(ordered)]


def _rename_case(case: Case, subject: int, index: int) -> Case:
    """Change the subject number and the knee index of a case, also in the names of its radiographs."""
    before, now = radiograph_stem(case.subject, case.index), radiograph_stem(subject, index)
    exposures = tuple(replace(taken, name=now + taken.name.removeprefix(before)) for taken in case.exposures)
    return replace(case, subject=subject, index=index, exposures=exposures)


def radiograph_stem(subject: int, index: int) -> str:
    """Build the prefix that the names of all radiographs of a knee share.

    Parameters
    ----------
    subject : int
        Number of the subject.
    index : int
        Index of the knee.

    Returns
    -------
    str
        Prefix of the names, such as "s0012_k0015".
    """
    return f"s{subject:04d}_k{index:04d}"


def select_subjects(plan: Plan, subjects: int) -> Plan:
    """Select random subjects of a plan, the same number per grade; their images do not change.

    The seed of the plan determines the selection. A larger selection includes every smaller selection.

    Parameters
    ----------
    plan : Plan
        Plan of the entire cohort.
    subjects : int
        Total number of subjects, a multiple of the number of grades.

    Returns
    -------
    Plan
        Plan with the selected subjects.

    Raises
    ------
    InputError
        If `subjects` is not a multiple of the number of grades, or exceeds the number of subjects in the plan.
    """
    of_grade: dict[int | None, dict[int, None]] = {}
    for case in plan.cases:
        of_grade.setdefault(case.knee.grade, {})[case.subject] = None
    each, rest = divmod(subjects, len(of_grade))
    most = min(map(len, of_grade.values()))
    if rest or not 1 <= each <= most:
        raise InputError(
            f"subjects must be a multiple of {len(of_grade)}, the number of grades, up to {most * len(of_grade)}, "
            f"got {subjects}"
        )
    rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(_SOME,)))
    chosen = {subject for whole in of_grade.values() for subject in rng.permutation(list(whole))[:each].tolist()}
    return replace(plan, cases=tuple(case for case in plan.cases if case.subject in chosen))


def _assign_subjects(knees: Sequence[int], bilateral: int) -> list[tuple[int, int, str | None]]:
    """Assign subject, grade and side to every knee; bilateral subjects are in proportion to the knees per grade."""
    for grade, count in enumerate(knees):
        require_integer(f"number of knees with grade {grade}", count, 0, 100_000, "")
    total = sum(knees)
    require_integer("bilateral", bilateral, 0, total // 2, "subjects")
    if total == 0:
        raise InputError("knees must be 1 or more in total, got sum(knees) = 0")
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
    """Change the image matrix of a protocol; if `matrix` is 0, return the protocol unchanged."""
    return protocol.resample(matrix) if matrix else protocol


def _make_variants(protocol: Protocol, preset: CohortPreset) -> list[Protocol]:
    """Make the variants of a protocol for all combinations of beam tilt and dose.

    Variants with the same geometry are consecutive, so that they can share path lengths.
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
    """Group the arguments for sampling one knee; the side is sampled if `side` is None."""

    seed: int
    knee_index: int
    subject: int
    grade: int
    side: str | None


def _sample_case(
    slot: _KneeSlot, protocols: list[Protocol], preset: CohortPreset, distributions: KneeDistributions
) -> Case:
    """Sample one knee, and the protocol and noise seed of each of its radiographs."""
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
            chance = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, _ACQUISITION, turn)))
            set_to = {field: getattr(protocol, field) for field in of_protocol}
            protocol = replace(sample_acquisition(protocol, rng=chance, side=knee.side), **set_to)
        exposures.append(Exposure(name, protocol, int(state[0] >> np.uint64(1))))
    return Case(subject=subject, index=number, knee=knee, exposures=tuple(exposures), grade_table=preset.grade_table)


@lru_cache(maxsize=1)  # The cache needs one entry, because both knees of a subject are sampled in succession.
def _sample_subject_fields(seed: int, subject: int, grade: int, distributions: KneeDistributions) -> Mapping[str, Any]:
    """Sample the fields that both knees of a subject share, from a separate random stream of the subject."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BODY, subject)))
    return sample_shared_fields(distributions, grade=grade, rng=rng)
