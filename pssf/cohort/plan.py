"""Who is in a cohort and how each knee is taken; drawn from a seed, made later."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..checks import InputError, require_choice, require_whole
from ..files import tables
from ..knee import Knee, draw_knee, knee_table
from ..protocol import Protocol, load_protocol, protocol_table

# Keys of the streams under a cohort's seed. A knee's index stands first, so the order of making changes nothing.
_SHAPE, _NOISE, _BODY = 0, 3, 2**31
# What the two knees of a subject share.
_BODY_FIELDS = ("sex", "stature_mm", "bone_scale", "cortex_scale", "limb_ap_mm", "fat_mm", "age_years")


@dataclass(frozen=True)
class Shot:
    """One radiograph to be made."""

    name: str
    protocol: Protocol
    seed: int


@dataclass(frozen=True)
class Case:
    """One knee of a subject, and the radiographs to be made of it."""

    subject: int
    index: int
    knee: Knee
    shots: tuple[Shot, ...]


@dataclass(frozen=True)
class Plan:
    """A cohort before it is made."""

    preset: str
    seed: int
    repeats: int
    cases: tuple[Case, ...]

    def table(self) -> dict[str, Any]:
        """All that decides the pixels of this cohort, JSON-ready."""
        return {
            "preset": self.preset,
            "seed": self.seed,
            "protocols": [protocol_table(shot.protocol) for shot in self.cases[0].shots],
            "knees": [{"subject": case.subject, "index": case.index, **knee_table(case.knee)} for case in self.cases],
        }


def preset_names() -> list[str]:
    """Names of the cohorts that come with the package."""
    return list(tables.data("presets"))


def plan_cohort(preset: str, *, seed: int, overrides: Mapping[str, Any] | None = None) -> Plan:
    """Draw a cohort.

    Both knees of a subject have one body (sex, stature, size of bones and cortex, limb, fat, age) and one grade. Given
    these, joint space, alignment, osteophytes, pose and trabeculae are drawn for each knee apart: they are alike by
    their grade alone. In people they correlate within a grade too; the ranges that are drawn from do not say by how
    much, and a number of our own is not put in their place.

    preset     a name of `data/presets.toml`
    overrides  entries that replace the preset's, such as {"knees": [2, 2, 2]} or {"protocols": ["reference"]}
    raises     InputError for an unknown preset, entry or protocol, or counts that do not fit
    """
    require_choice("preset", preset, preset_names())
    require_whole("seed", seed, 0, 2**63 - 1, "")
    table = dict(tables.data("presets")[preset])
    for name, value in (overrides or {}).items():
        require_choice("preset entry", name, tuple(table))
        table[name] = value
    protocols = [load_protocol(name) for name in table["protocols"]]
    names = [protocol.name for protocol in protocols]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"protocols = {', '.join(names) or 'none'}; allowed: one or more, each once")
    cases = []
    for index, (subject, grade, side) in enumerate(_people(table["knees"], table["bilateral"])):
        cases.append(_case(seed, index, subject, grade, side, protocols))
    return Plan(preset=preset, seed=seed, repeats=table["repeats"], cases=tuple(cases))


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


def _case(seed: int, index: int, subject: int, grade: int, side: str | None, protocols: list[Protocol]) -> Case:
    fixed = dict(_body(seed, subject))
    if side is not None:
        fixed["side"] = side
    shape = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index, _SHAPE)))
    knee = draw_knee(grade=grade, rng=shape, **fixed)
    shots = []
    for place, protocol in enumerate(protocols):
        state = np.random.SeedSequence(seed, spawn_key=(index, _NOISE, place)).generate_state(1, np.uint64)
        shots.append(Shot(f"s{subject:04d}_k{index:04d}_{protocol.name}", protocol, int(state[0] >> np.uint64(1))))
    return Case(subject=subject, index=index, knee=knee, shots=tuple(shots))


@lru_cache(maxsize=1)  # the other knee of a subject comes next
def _body(seed: int, subject: int) -> Mapping[str, Any]:
    """The fields that the knees of a subject share, drawn from a stream of the subject's own."""
    body = draw_knee(grade=0, rng=np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BODY, subject))))
    return {name: getattr(body, name) for name in _BODY_FIELDS}
