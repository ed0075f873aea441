"""Plans of radiographs for a sensitivity analysis over the parameters of knee and protocol.

The module plans two designs. Sobol samples vary all parameters at once (Sobol 1993; Saltelli 2010). Sensitivity pairs
change one parameter of a cohort knee at unchanged noise, which yields a local slope.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from ...cohort.cohort_plan import (
    Case,
    Exposure,
    Plan,
    radiograph_stem,
)
from ...core.checks import Array, InputError, require_integer
from ...model.knee import Knee, Osteophyte
from ...model.protocol import Protocol

# Smallest number of Sobol samples. With 64 samples, at least 96 % of the 95 % intervals contain the known index of a
# test function (tests/test_sensitivity_analysis.py). Decorrelation needs more samples than columns.
MIN_SAMPLES = 64
# Number of distinct seeds that a float64 between 0 and 1 can represent.
_SEED_COUNT = 2**53
# Minimum osteophyte size, in mm; equal to the limit in the knee model.
_MIN_OSTEOPHYTE_MM = 0.2
# Sites of the osteophytes that are added to a knee without osteophytes.
_DEFAULT_OSTEOPHYTE_SITES = ("medial_tibia", "medial_femur")
# Percentiles of the cohort that define the bounds of a knee parameter.
_PERCENTILES = (5.0, 95.0)
# Step of a sensitivity pair, as a fraction of the difference between upper and lower parameter bound; assumed.
STEP_FRACTION = 0.1
# Largest ratio of the mAs at an imaging site to the reference mAs, dimensionless; assumed.
_MAS = 2.0
# Largest difference between the tube voltage at an imaging site and the reference, in kV (assumed).
_KV = 5.0
# Largest ratio of the focal spot width at an imaging site to the reference width, dimensionless (assumed).
_SPOT = 1.5
# Largest difference between the beam tilt at an imaging site and the reference, in degrees (assumed).
_TILT_DEG = 3.0
# Parameter group of the random seeds of trabecular texture and quantum noise.
NOISE_GROUP = "texture and noise"


class KneeAcquisition(NamedTuple):
    """Knee, protocol and seed of the quantum noise.

    Attributes
    ----------
    knee : Knee
        Parameters of the knee.
    protocol : Protocol
        Acquisition parameters.
    seed : int
        Seed of the quantum noise.
    """

    knee: Knee
    protocol: Protocol
    seed: int


@dataclass(frozen=True)
class Parameter:
    """One parameter of the sensitivity analysis.

    Parameters
    ----------
    group : str
        Parameter group; Sobol indices are computed per group.
    label : str
        Label in tables. Knee parameters have the labels of `statistics.analyses.knee_parameters.PARAMETERS`.
    read_value : callable
        Function that returns the parameter value of a `KneeAcquisition`.
    set_value : callable
        Function that returns a `KneeAcquisition` with a new parameter value.
    """

    group: str
    label: str
    read_value: Callable[[KneeAcquisition], float]
    set_value: Callable[[KneeAcquisition, float], KneeAcquisition]


def _replace_anatomy(knee: Knee, **fields: Any) -> Knee:
    """Change the anatomy of a knee and remove its grade, which may no longer be correct."""
    return replace(knee, **fields, grade=None, grade_table=None, reader_grade=None)


def _make_knee_parameter(group: str, label: str, name: str) -> Parameter:
    """Make a parameter that reads and sets one field of `Knee`."""

    def changed(taken: KneeAcquisition, value: float) -> KneeAcquisition:
        """Set the field of the knee, rounded to four decimals."""
        field: dict[str, Any] = {name: round(value, 4)}
        return taken._replace(knee=_replace_anatomy(taken.knee, **field))

    return Parameter(group, label, lambda taken: float(getattr(taken.knee, name)), changed)


def _make_protocol_parameter(group: str, label: str, name: str) -> Parameter:
    """Make a parameter that reads and sets one field of `Protocol`."""

    def changed(taken: KneeAcquisition, value: float) -> KneeAcquisition:
        """Set the field of the protocol, rounded to six decimals."""
        field: dict[str, Any] = {name: round(value, 6)}
        return taken._replace(protocol=replace(taken.protocol, **field))

    return Parameter(group, label, lambda taken: float(getattr(taken.protocol, name)), changed)


def _largest_osteophyte_mm(acquisition: KneeAcquisition) -> float:
    """Return the size of the largest osteophyte, in mm; 0 without osteophytes."""
    return max((one.size_mm for one in acquisition.knee.osteophytes), default=0.0)


def _scale_osteophytes(acquisition: KneeAcquisition, size_mm: float) -> KneeAcquisition:
    """Scale all osteophytes by the same factor, so that the largest osteophyte has the specified size.

    If the knee has no osteophytes, two are added at the medial margin.
    """
    largest = _largest_osteophyte_mm(acquisition)
    before = acquisition.knee.osteophytes or tuple(
        Osteophyte(site=site, size_mm=1.0) for site in _DEFAULT_OSTEOPHYTE_SITES
    )
    sizes = [(one, min(one.max_size_mm, one.size_mm * size_mm / (largest or 1.0))) for one in before]
    grown = tuple(replace(one, size_mm=round(mm, 4)) for one, mm in sizes if mm >= _MIN_OSTEOPHYTE_MM)
    return acquisition._replace(knee=_replace_anatomy(acquisition.knee, osteophytes=grown))


def _replace_seeds(acquisition: KneeAcquisition, value: float) -> KneeAcquisition:
    """Set the seeds of trabecular texture and quantum noise from a number between 0 and 1."""
    seed = int(value * (_SEED_COUNT - 1))
    return acquisition._replace(knee=replace(acquisition.knee, texture_seed=seed), seed=seed)


PARAMETER_SPACE = {
    "nominal_jsw_medial_mm": _make_knee_parameter("joint space", "nominal JSW medial, mm", "jsw_medial_mm"),
    "nominal_jsw_lateral_mm": _make_knee_parameter("joint space", "nominal JSW lateral, mm", "jsw_lateral_mm"),
    "largest_osteophyte_mm": Parameter(
        "osteophytes", "largest osteophyte, mm", _largest_osteophyte_mm, _scale_osteophytes
    ),
    "subchondral_plate": _make_knee_parameter(
        "subchondral plate and cortex", "subchondral bone plate, relative", "subchondral_plate"
    ),
    "cortex_scale": _make_knee_parameter("subchondral plate and cortex", "cortex scale", "cortex_scale"),
    "bone_density": _make_knee_parameter("trabecular bone", "bone density, relative", "bone_density"),
    "varus_deg": _make_knee_parameter("alignment and pose", "varus, deg", "varus_deg"),
    "flexion_deg": _make_knee_parameter("alignment and pose", "flexion, deg", "flexion_deg"),
    "rotation_deg": _make_knee_parameter("alignment and pose", "rotation, deg", "rotation_deg"),
    "limb_ap_mm": _make_knee_parameter("limb", "limb AP thickness, mm", "limb_ap_mm"),
    "mas": _make_protocol_parameter("technique", "mAs", "mas"),
    "tube_kv": _make_protocol_parameter("technique", "tube voltage, kV", "tube_kv"),
    "focal_spot_mm": _make_protocol_parameter("technique", "focal spot, mm", "focal_spot_mm"),
    "beam_angle_deg": _make_protocol_parameter("beam", "beam tilt, deg", "beam_angle_deg"),
    "chance": Parameter(NOISE_GROUP, NOISE_GROUP, lambda taken: 0.5, _replace_seeds),
}
# Parameters that sensitivity pairs change; random seeds are excluded because they have no slope.
SLOPE_PARAMETERS = tuple(name for name in PARAMETER_SPACE if name != "chance")


def compute_bounds(plan: Plan, reference: str) -> dict[str, tuple[float, float]]:
    """Compute the bounds of each parameter.

    Knee parameters span the 5th to 95th percentile of the knees of the plan. Protocol parameters span the assumed
    differences between imaging sites. Parameters that are constant over the knees are omitted.

    Parameters
    ----------
    plan : Plan
        Plan of the cohort.
    reference : str
        Name of the reference protocol; its median values are the centres of the protocol parameter bounds.

    Returns
    -------
    dict of str to tuple of float
        Lower and upper bound of each parameter, in the unit of the parameter.

    Raises
    ------
    InputError
        The plan does not contain the protocol.
    """
    taken = [_find_acquisition(case, reference) for case in plan.cases]
    middle = {
        name: float(np.median([PARAMETER_SPACE[name].read_value(one) for one in taken])) for name in PARAMETER_SPACE
    }
    bounds = {}
    for name in PARAMETER_SPACE:
        low, high = np.percentile([PARAMETER_SPACE[name].read_value(one) for one in taken], _PERCENTILES)
        bounds[name] = (float(low), float(high))
    bounds["mas"] = (middle["mas"] / _MAS, middle["mas"] * _MAS)
    bounds["tube_kv"] = (middle["tube_kv"] - _KV, middle["tube_kv"] + _KV)
    bounds["focal_spot_mm"] = (middle["focal_spot_mm"] / _SPOT, middle["focal_spot_mm"] * _SPOT)
    bounds["beam_angle_deg"] = (middle["beam_angle_deg"] - _TILT_DEG, middle["beam_angle_deg"] + _TILT_DEG)
    bounds["chance"] = (0.0, 1.0)
    # A parameter that is constant over the knees has equal bounds and is omitted.
    return {name: (low, high) for name, (low, high) in bounds.items() if high > low}


def build_salib_problem(bounds: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """Build the SALib problem definition, with parameter groups.

    Parameters
    ----------
    bounds : mapping of str to tuple of float
        Bounds from `compute_bounds`.

    Returns
    -------
    dict of str to Any
        Number, names, bounds and groups of the parameters.
    """
    return {
        "num_vars": len(bounds),
        "names": list(bounds),
        "bounds": [list(pair) for pair in bounds.values()],
        "groups": [PARAMETER_SPACE[name].group for name in bounds],
    }


def sample_parameters(bounds: Mapping[str, tuple[float, float]], samples: int, seed: int) -> Array:
    """Sample the points of a Sobol design in the row order that SALib expects.

    Two decorrelated Latin hypercubes A and B are sampled. Each sample yields a row of A, mixed rows, and a row of B.
    There is one mixed row per group: the columns of the group are from B, the other columns from A. The Sobol sequence
    is not used: with 64 points, some columns have a correlation of 0.75 under any scrambling, and the 95 % intervals
    contain only 89 % of the known indices.

    Parameters
    ----------
    bounds : mapping of str to tuple of float
        Bounds from `compute_bounds`.
    samples : int
        Number of samples N of the design.
    seed : int
        Seed of the Latin hypercube sampling.

    Returns
    -------
    (samples * (groups + 2), parameters) float array
        Points, each column in the unit of its parameter.
    """
    unit = sample_unit_design([PARAMETER_SPACE[name].group for name in bounds], samples, seed)
    low, high = np.array(list(bounds.values())).T
    return np.asarray(low + unit * (high - low))


def sample_unit_design(groups: Sequence[str], samples: int, seed: int) -> Array:
    """Sample the points of a Sobol design between 0 and 1, in the row order that SALib expects.

    Parameters
    ----------
    groups : sequence of str
        Group of each parameter.
    samples : int
        Number of samples N of the design, more than twice the number of parameters.
    seed : int
        Seed of the Latin hypercube sampling.

    Returns
    -------
    (samples * (groups + 2), parameters) float array, dimensionless
        Points, as `sample_parameters` describes them.
    """
    rng = np.random.default_rng(seed)
    layers = rng.permuted(np.tile(np.arange(samples)[:, None], (1, 2 * len(groups))), axis=0)
    one, other = np.split(_decorrelate((layers + rng.random(layers.shape)) / samples), 2, axis=1)
    of = np.array(groups)
    between = [np.where(of == group, other, one) for group in dict.fromkeys(groups)]
    return np.stack([one, *between, other], axis=1).reshape(-1, len(groups))


def _decorrelate(unit_samples: Array) -> Array:
    """Reorder the values of each column so that the columns are uncorrelated.

    The method is described by Iman and Conover 1982 (Commun Stat B 11, 311). `unit_samples` is a (samples, columns)
    array of numbers between 0 and 1, with more samples than columns.
    """
    scores = ndtri(unit_samples)
    scores = (scores - scores.mean(axis=0)) / scores.std(axis=0)
    free = np.linalg.solve(np.linalg.cholesky(np.corrcoef(scores.T)), scores.T).T
    return np.take_along_axis(np.sort(unit_samples, axis=0), free.argsort(axis=0).argsort(axis=0), axis=0)


def plan_sobol_samples(plan: Plan, *, samples: int, reference: str) -> Plan:
    """Plan the radiographs of a Sobol design.

    All other parameters have the values of the first knee in the plan. In each exposure, `retest_kind` is "sobol" and
    `repeat_index` is the design row, starting at 1.

    Parameters
    ----------
    plan : Plan
        Plan of the cohort.
    samples : int
        Number of samples N, at least `MIN_SAMPLES`.
    reference : str
        Name of the protocol at the centre of the design.

    Returns
    -------
    Plan
        Plan with one case per distinct knee.

    Raises
    ------
    InputError
        There are too few samples, or the plan does not contain the protocol.
    """
    require_integer("sobol_samples", samples, MIN_SAMPLES, 2**16, "samples")
    first = _find_acquisition(plan.cases[0], reference)
    bounds = compute_bounds(plan, reference)
    at: dict[Knee, list[tuple[int, KneeAcquisition]]] = {}
    for row, point in enumerate(sample_parameters(bounds, samples, plan.seed), start=1):
        taken = first
        for name, value in zip(bounds, point, strict=True):
            taken = PARAMETER_SPACE[name].set_value(taken, float(value))
        at.setdefault(taken.knee, []).append((row, taken))
    cases = []
    for index, (knee, rows) in enumerate(at.items()):
        exposures = [
            Exposure(
                f"sobol{row:06d}",
                taken.protocol,
                taken.seed,
                retest_kind="sobol",
                repeat_index=row,
                source_knee=plan.cases[0].index,
            )
            for row, taken in rows
        ]
        cases.append(replace(plan.cases[0], subject=index, index=index, knee=knee, exposures=tuple(exposures)))
    return Plan(preset=f"{plan.preset}, Sobol samples", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases))


def plan_sensitivity_pairs(
    plan: Plan, *, knees: int, reference: str, parameters: Sequence[str] = SLOPE_PARAMETERS
) -> Plan:
    """Plan a second radiograph of some knees for each parameter, with the parameter increased by a tenth of its range.

    The noise seed is unchanged. Knees are selected from each grade in turn. In each exposure, `retest_kind` is the
    parameter name. If the increased value is not allowed, the parameter is decreased instead.

    Parameters
    ----------
    plan : Plan
        Plan of the cohort.
    knees : int
        Number of knees, at least 2.
    reference : str
        Name of the protocol under which the knees are imaged.
    parameters : sequence of str
        Names of parameters to change, from `PARAMETER_SPACE`.

    Returns
    -------
    Plan
        Plan with one case per cohort knee and distinct anatomy.

    Raises
    ------
    InputError
        There are fewer than two knees, or the plan does not contain the protocol.
    """
    require_integer("sensitivity_knees", knees, 2, 100_000, "knees")
    bounds = compute_bounds(plan, reference)
    cases: list[Case] = []
    spans = {name: bounds[name][1] - bounds[name][0] for name in parameters if name in bounds}
    for case in interleave_grades(plan)[:knees]:
        at: dict[Knee, list[tuple[str, KneeAcquisition]]] = {}
        own = _find_acquisition(case, reference)
        for name, span in spans.items():
            taken = _step_parameter(own, PARAMETER_SPACE[name], STEP_FRACTION * span)
            at.setdefault(taken.knee, []).append((name, taken))
        for knee, rows in at.items():
            exposures = []
            for name, taken in rows:
                label = f"{radiograph_stem(case.subject, case.index)}_{name}"
                exposures.append(
                    Exposure(
                        label, taken.protocol, taken.seed, retest_kind=name, repeat_index=1, source_knee=case.index
                    )
                )
            cases.append(replace(case, index=len(cases), knee=knee, exposures=tuple(exposures)))
    return Plan(preset=f"{plan.preset}, sensitivity pairs", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases))


def interleave_grades(plan: Plan) -> list[Case]:
    """Order the cases of a plan so that the grades alternate.

    Parameters
    ----------
    plan : Plan
        Plan of the cohort.

    Returns
    -------
    list of Case
        All cases: the first case of each grade, then the second case of each grade, and so on.
    """
    seen: dict[int | None, int] = {}
    places = []
    for case in plan.cases:
        seen[case.knee.grade] = seen.get(case.knee.grade, -1) + 1
        places.append((seen[case.knee.grade], case.index))
    return [plan.cases[place] for place in sorted(range(len(places)), key=lambda place: places[place])]


def _step_parameter(acquisition: KneeAcquisition, parameter: Parameter, step: float) -> KneeAcquisition:
    """Increase a parameter by a step, or decrease it if the increased value is not allowed."""
    try:
        return parameter.set_value(acquisition, parameter.read_value(acquisition) + step)
    except InputError:
        return parameter.set_value(acquisition, parameter.read_value(acquisition) - step)


def _find_acquisition(case: Case, reference: str) -> KneeAcquisition:
    """Find the exposure of a case under the reference protocol; raise InputError if there is none."""
    for exposure in case.exposures:
        if exposure.protocol.name == reference:
            return KneeAcquisition(case.knee, exposure.protocol, exposure.seed)
    known = ", ".join(exposure.protocol.name for exposure in case.exposures)
    raise InputError(f"protocol must be one of {known}, got {reference!r}")
