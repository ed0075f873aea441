"""The space of a knee's and a protocol's parameters, and plans of radiographs in it.

A sample of all of the space at once, for shares of variance (Sobol 1993; Saltelli 2010), and pairs of a cohort's
knees of which one parameter is other, with the noise held, for local slopes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from ..cohort.plan import Case, Exposure, Plan, stem
from ..core.checks import Array, InputError, require_whole
from ..model.knee import Knee, Osteophyte
from ..model.protocol import Protocol

# Of as many, intervals of shares hold 96 % and more of known functions (tests/test_space.py); of fewer than columns no
# sample is free of correlation.
LEAST_SAMPLES = 64
_SEEDS = 2**53  # that a number from 0 to 1 can tell apart
_SMALLEST_MM = 0.2  # of an osteophyte, as `model.severity` has it
_SITES = ("medial_tibia", "medial_femur")
_PERCENTILES = (5.0, 95.0)
STEP = 0.1  # of a pair, as a share of what a parameter spans
# A share of its own range by which the protocol's values differ between sites (judgement).
_MAS, _KV, _SPOT, _TILT_DEG = 2.0, 5.0, 1.5, 3.0
CHANCE = "texture and noise"


class Taken(NamedTuple):
    """A knee under a protocol, with the seed of its noise."""

    knee: Knee
    protocol: Protocol
    seed: int


@dataclass(frozen=True)
class Parameter:
    """One direction of the space.

    group  that shares of variance are given for
    label  as `statistics.parameters` calls it, for those of a knee
    """

    group: str
    label: str
    value: Callable[[Taken], float]
    changed: Callable[[Taken, float], Taken]


def _other(knee: Knee, **fields: Any) -> Knee:
    """A knee with other anatomy, whose grade is no longer the one that it was sampled for."""
    return replace(knee, **fields, grade=None, grade_table=None, grade_read=None)


def _of_knee(group: str, label: str, name: str) -> Parameter:
    def changed(taken: Taken, value: float) -> Taken:
        field: dict[str, Any] = {name: round(value, 4)}
        return taken._replace(knee=_other(taken.knee, **field))

    return Parameter(group, label, lambda taken: float(getattr(taken.knee, name)), changed)


def _of_protocol(group: str, label: str, name: str) -> Parameter:
    def changed(taken: Taken, value: float) -> Taken:
        field: dict[str, Any] = {name: round(value, 6)}
        return taken._replace(protocol=replace(taken.protocol, **field))

    return Parameter(group, label, lambda taken: float(getattr(taken.protocol, name)), changed)


def _largest_mm(taken: Taken) -> float:
    return max((one.size_mm for one in taken.knee.osteophytes), default=0.0)


def _grown(taken: Taken, size_mm: float) -> Taken:
    """All osteophytes grown alike so that the largest has a size; a knee without has two on its medial side."""
    largest = _largest_mm(taken)
    before = taken.knee.osteophytes or tuple(Osteophyte(site=site, size_mm=1.0) for site in _SITES)
    sizes = [(one, min(one.tallest_mm, one.size_mm * size_mm / (largest or 1.0))) for one in before]
    grown = tuple(replace(one, size_mm=round(mm, 4)) for one, mm in sizes if mm >= _SMALLEST_MM)
    return taken._replace(knee=_other(taken.knee, osteophytes=grown))


def _other_chance(taken: Taken, value: float) -> Taken:
    seed = int(value * (_SEEDS - 1))
    return taken._replace(knee=replace(taken.knee, texture_seed=seed), seed=seed)


SPACE = {
    "nominal_jsw_medial_mm": _of_knee("joint space", "nominal JSW medial, mm", "jsw_medial_mm"),
    "nominal_jsw_lateral_mm": _of_knee("joint space", "nominal JSW lateral, mm", "jsw_lateral_mm"),
    "largest_osteophyte_mm": Parameter("osteophytes", "largest osteophyte, mm", _largest_mm, _grown),
    "subchondral_plate": _of_knee("plate and cortex", "subchondral plate, relative", "subchondral_plate"),
    "cortex_scale": _of_knee("plate and cortex", "cortex scale", "cortex_scale"),
    "bone_density": _of_knee("spongy bone", "bone density, relative", "bone_density"),
    "varus_deg": _of_knee("alignment and pose", "varus, deg", "varus_deg"),
    "flexion_deg": _of_knee("alignment and pose", "flexion, deg", "flexion_deg"),
    "rotation_deg": _of_knee("alignment and pose", "rotation, deg", "rotation_deg"),
    "limb_ap_mm": _of_knee("limb", "limb, mm", "limb_ap_mm"),
    "mas": _of_protocol("technique", "mAs", "mas"),
    "tube_kv": _of_protocol("technique", "tube voltage, kV", "tube_kv"),
    "focal_spot_mm": _of_protocol("technique", "focal spot, mm", "focal_spot_mm"),
    "beam_angle_deg": _of_protocol("beam", "tilt of the beam, deg", "beam_angle_deg"),
    "chance": Parameter(CHANCE, CHANCE, lambda taken: 0.5, _other_chance),
}
# Those that a pair changes: chance has no slope.
SLOPES = tuple(name for name in SPACE if name != "chance")


def bounds_of(plan: Plan, reference: str) -> dict[str, tuple[float, float]]:
    """What each parameter spans: 5 to 95 per cent of the plan's knees; of a protocol's, what sites differ by.

    raises  InputError for a protocol that the plan does not have
    """
    taken = [_as_planned(case, reference) for case in plan.cases]
    middle = {name: float(np.median([SPACE[name].value(one) for one in taken])) for name in SPACE}
    bounds = {}
    for name in SPACE:
        low, high = np.percentile([SPACE[name].value(one) for one in taken], _PERCENTILES)
        bounds[name] = (float(low), float(high))
    bounds["mas"] = (middle["mas"] / _MAS, middle["mas"] * _MAS)
    bounds["tube_kv"] = (middle["tube_kv"] - _KV, middle["tube_kv"] + _KV)
    bounds["focal_spot_mm"] = (middle["focal_spot_mm"] / _SPOT, middle["focal_spot_mm"] * _SPOT)
    bounds["beam_angle_deg"] = (middle["beam_angle_deg"] - _TILT_DEG, middle["beam_angle_deg"] + _TILT_DEG)
    bounds["chance"] = (0.0, 1.0)
    # What is alike in all knees spans nothing, and is left out.
    return {name: (low, high) for name, (low, high) in bounds.items() if high > low}


def problem_of(bounds: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """The space as SALib takes it, by groups."""
    return {
        "num_vars": len(bounds),
        "names": list(bounds),
        "bounds": [list(pair) for pair in bounds.values()],
        "groups": [SPACE[name].group for name in bounds],
    }


def sample(bounds: Mapping[str, tuple[float, float]], samples: int, seed: int) -> Array:
    """Two Latin hypercubes, and the first with one group after the other of the second, as SALib's analysis takes them.

    Points of Sobol's sequence would not do: of 64 in so many directions some correlate by 0.75, whatever the
    scrambling, and intervals hold 89 %.

    returns  (samples * (groups + 2), parameters) points, each in its parameter's own unit
    """
    rng = np.random.default_rng(seed)
    layers = rng.permuted(np.tile(np.arange(samples)[:, None], (1, 2 * len(bounds))), axis=0)
    one, other = np.split(_uncorrelated((layers + rng.random(layers.shape)) / samples), 2, axis=1)
    of = np.array([SPACE[name].group for name in bounds])
    between = [np.where(of == group, other, one) for group in dict.fromkeys(of)]
    unit = np.stack([one, *between, other], axis=1).reshape(-1, len(bounds))
    low, high = np.array(list(bounds.values())).T
    return np.asarray(low + unit * (high - low))


def _uncorrelated(unit: Array) -> Array:
    """(samples, columns) the same values in every column, in an order that frees columns of correlation.

    Iman and Conover 1982, Commun Stat B 11, 311. More samples than columns.
    """
    scores = ndtri(unit)
    scores = (scores - scores.mean(axis=0)) / scores.std(axis=0)
    free = np.linalg.solve(np.linalg.cholesky(np.corrcoef(scores.T)), scores.T).T
    return np.take_along_axis(np.sort(unit, axis=0), free.argsort(axis=0).argsort(axis=0), axis=0)


def plan_shares(plan: Plan, *, samples: int, reference: str) -> Plan:
    """Radiographs at `sample`: all that is not of the space is that of the plan's first knee.

    An exposure's kind is "share", its turn the row of the sample from 1.

    samples  LEAST_SAMPLES or more
    raises   InputError for fewer, or a protocol that the plan does not have
    """
    require_whole("shares", samples, LEAST_SAMPLES, 2**16, "samples")
    first = _as_planned(plan.cases[0], reference)
    bounds = bounds_of(plan, reference)
    at: dict[Knee, list[tuple[int, Taken]]] = {}
    for row, point in enumerate(sample(bounds, samples, plan.seed), start=1):
        taken = first
        for name, value in zip(bounds, point, strict=True):
            taken = SPACE[name].changed(taken, float(value))
        at.setdefault(taken.knee, []).append((row, taken))
    cases = []
    for index, (knee, rows) in enumerate(at.items()):
        exposures = [
            Exposure(f"share{row:06d}", taken.protocol, taken.seed, kind="share", turn=row, of_knee=plan.cases[0].index)
            for row, taken in rows
        ]
        cases.append(replace(plan.cases[0], subject=index, index=index, knee=knee, exposures=tuple(exposures)))
    return Plan(preset=f"{plan.preset}, shares", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases))


def plan_pairs(plan: Plan, *, knees: int, reference: str, parameters: Sequence[str] = SLOPES) -> Plan:
    """The first knees of each grade in turn, each once with every parameter a tenth of its span larger, noise held.

    An exposure's kind is the parameter. Where the larger value is not allowed the smaller one is taken.

    raises  InputError for fewer than two knees, or a protocol that the plan does not have
    """
    require_whole("pairs", knees, 2, 100_000, "knees")
    bounds = bounds_of(plan, reference)
    cases: list[Case] = []
    spans = {name: bounds[name][1] - bounds[name][0] for name in parameters if name in bounds}
    for case in in_turn(plan)[:knees]:
        at: dict[Knee, list[tuple[str, Taken]]] = {}
        own = _as_planned(case, reference)
        for name, span in spans.items():
            taken = _beside(own, SPACE[name], STEP * span)
            at.setdefault(taken.knee, []).append((name, taken))
        for knee, rows in at.items():
            exposures = []
            for name, taken in rows:
                label = f"{stem(case.subject, case.index)}_{name}"
                exposures.append(Exposure(label, taken.protocol, taken.seed, kind=name, turn=1, of_knee=case.index))
            cases.append(replace(case, index=len(cases), knee=knee, exposures=tuple(exposures)))
    return Plan(preset=f"{plan.preset}, pairs", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases))


def in_turn(plan: Plan) -> list[Case]:
    """The cases of a plan, a grade after the other."""
    seen: dict[int | None, int] = {}
    places = []
    for case in plan.cases:
        seen[case.knee.grade] = seen.get(case.knee.grade, -1) + 1
        places.append((seen[case.knee.grade], case.index))
    return [plan.cases[place] for place in sorted(range(len(places)), key=lambda place: places[place])]


def _beside(own: Taken, parameter: Parameter, step: float) -> Taken:
    try:
        return parameter.changed(own, parameter.value(own) + step)
    except InputError:
        return parameter.changed(own, parameter.value(own) - step)


def _as_planned(case: Case, reference: str) -> Taken:
    for exposure in case.exposures:
        if exposure.protocol.name == reference:
            return Taken(case.knee, exposure.protocol, exposure.seed)
    known = ", ".join(exposure.protocol.name for exposure in case.exposures)
    raise InputError(f"protocol = {reference!r}; allowed: {known}")
