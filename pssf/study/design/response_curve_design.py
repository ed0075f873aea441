"""Plans of response curves: knees imaged again while one protocol parameter is changed in steps.

The quantum noise of each step is independent. The agreement between a feature at a step and the same feature in the
cohort therefore includes the effect of noise. An axis may also change coupled parameters, so that only the investigated
effect varies; see `PROTOCOL_AXES`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...cohort.cohort_plan import (
    Case,
    Exposure,
    Plan,
    radiograph_stem,
)
from ...core.checks import InputError, require_integer
from ...model.protocol import Protocol
from .classification_tasks import TASKS, select_contrast

if TYPE_CHECKING:
    import pandas as pd

# Second key of the random stream, after the knee index; `cohort.cohort_plan` uses other keys.
_CURVE_STREAM = 6
# Exponent of the 15 % rule: halve the mAs for 15 % more kV (Bushong, Radiologic Science for Technologists; cited from
# memory).
_KV_EXPONENT = np.log(2) / np.log(1.15)


@dataclass(frozen=True, kw_only=True)
class DesignedManifests:
    """Manifests of designed radiographs; the columns ``kind`` and ``repeat_index`` identify each radiograph.

    Parameters
    ----------
    response_curves : DataFrame, optional
        Radiographs planned by `plan_response_curves`.
    sobol_samples : DataFrame, optional
        Radiographs planned by `sensitivity_plan.plan_sobol_samples`.
    sobol_sample_count : int
        Number of samples N of the Sobol design.
    sensitivity_pairs : DataFrame, optional
        Radiographs planned by `sensitivity_plan.plan_sensitivity_pairs`.
    bounds : mapping of str to tuple of float
        Lower and upper bound of each parameter, from `sensitivity_plan.compute_bounds`.
    """

    response_curves: "pd.DataFrame | None" = None
    sobol_samples: "pd.DataFrame | None" = None
    sobol_sample_count: int = 0
    sensitivity_pairs: "pd.DataFrame | None" = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def list_manifests(self) -> "list[pd.DataFrame]":
        """List the manifests that are not None.

        Returns
        -------
        list of DataFrame
            Manifests of designed radiographs.
        """
        return [
            table for table in (self.response_curves, self.sobol_samples, self.sensitivity_pairs) if table is not None
        ]


@dataclass(frozen=True, kw_only=True)
class ProtocolAxis:
    """Protocol parameter that a response curve varies.

    Parameters
    ----------
    label : str
        Axis label in figures, with the unit of a step or the quantity to which it is relative.
    field : str
        Field of `Protocol` that is varied.
    step_kind : str
        "factor" multiplies the protocol value by a step; "offset" adds a step to the protocol value.
    steps : tuple of float
        Seven steps, including the unchanged protocol (factor 1 or offset 0).
    scale : str
        Scale of the axis in figures and of the interpolation between steps: "linear" or "log".
    coupled_fields : callable
        Function of the protocol and the new value of `field` that returns the values of coupled fields.
    """

    label: str
    field: str
    step_kind: str
    steps: tuple[float, ...]
    scale: str = "linear"
    coupled_fields: Callable[[Protocol, float], dict[str, Any]] = lambda protocol, value: {}

    @property
    def reference_step(self) -> float:
        """Step for which the protocol is unchanged."""
        return 1.0 if self.step_kind == "factor" else 0.0

    def vary(self, protocol: Protocol, step: float) -> Protocol:
        """Return the protocol after a change by one step.

        Parameters
        ----------
        protocol : Protocol
            Unchanged protocol.
        step : float
            Factor or offset that is applied to the field.

        Returns
        -------
        Protocol
            Protocol with the new values of the field and of coupled fields.

        Raises
        ------
        InputError
            The new value is outside the allowed range of the field.
        """
        before = getattr(protocol, self.field)
        value = round(before * step if self.step_kind == "factor" else before + step, 6)
        return replace(protocol, **{self.field: value, **self.coupled_fields(protocol, value)})


def _hold_exposure(protocol: Protocol, tube_kv: float) -> dict[str, Any]:
    """Compute the mAs that keeps the exposure constant at a new tube voltage, by the 15 % rule."""
    return {"mas": round(protocol.mas * (protocol.tube_kv / tube_kv) ** float(_KV_EXPONENT), 4)}


def _hold_field_of_view(protocol: Protocol, pixel_mm: float) -> dict[str, Any]:
    """Compute the numbers of rows and columns that keep the field of view constant at a new pixel pitch."""
    return {name: round(getattr(protocol, name) * protocol.pixel_mm / pixel_mm) for name in ("rows", "cols")}


def _hold_detector_kerma(protocol: Protocol, sdd_mm: float) -> dict[str, Any]:
    """Compute the source-object distance and mAs that keep the detector kerma constant at a new SDD.

    SDD is the source-detector distance. The object-detector distance does not change.
    """
    mas = round(protocol.mas * (sdd_mm / protocol.sdd_mm) ** 2, 4)
    return {"sod_mm": round(sdd_mm - (protocol.sdd_mm - protocol.sod_mm), 4), "mas": mas}


# Axes that do not change the geometry are first, because one ray casting can be used for all their steps. The last axis
# rotates the leg, which requires a new knee model.
PROTOCOL_AXES = {
    "dose": ProtocolAxis(
        label="dose (relative mAs)",
        field="mas",
        step_kind="factor",
        steps=(1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0),
        scale="log",
    ),
    "kv": ProtocolAxis(
        label="tube voltage (change in kV; mAs by the 15 % rule)",
        field="tube_kv",
        step_kind="offset",
        steps=(-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 20.0),
        coupled_fields=_hold_exposure,
    ),
    "focal_spot": ProtocolAxis(
        label="focal spot (relative width)",
        field="focal_spot_mm",
        step_kind="factor",
        steps=(0.0, 0.5, 1, 1.5, 2, 3, 4),
    ),
    "scatter": ProtocolAxis(
        label="grid ratio (increase; less scatter, same mAs)",
        field="grid_ratio",
        step_kind="offset",
        steps=(0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0),
    ),
    "pixel_size": ProtocolAxis(
        label="pixel pitch (relative; same field of view)",
        field="pixel_mm",
        step_kind="factor",
        steps=(2 / 3, 1.0, 4 / 3, 5 / 3, 2.0, 8 / 3, 10 / 3),
        coupled_fields=_hold_field_of_view,
    ),
    "distance": ProtocolAxis(
        label="source-detector distance (relative; same detector kerma)",
        field="sdd_mm",
        step_kind="factor",
        steps=(0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3),
        coupled_fields=_hold_detector_kerma,
    ),
    "tilt": ProtocolAxis(
        label="beam tilt (change in deg)",
        field="beam_angle_deg",
        step_kind="offset",
        steps=(-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0),
    ),
    "rotation": ProtocolAxis(
        label="leg rotation (change in deg)",
        field="rotation_deg",
        step_kind="offset",
        steps=(-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0),
    ),
}


def plan_response_curves(plan: Plan, *, knees: int, reference: str, axes: Sequence[str] = tuple(PROTOCOL_AXES)) -> Plan:
    """Plan radiographs of some knees at every step of every axis.

    One knee per subject is used. Half of the knees have grade 0. The other half is divided evenly between the grades of
    the second class in the task from `classification_tasks.select_contrast`. In each exposure, `retest_kind` is the
    axis name and `repeat_index` is the step number, starting at 1.

    Parameters
    ----------
    plan : Plan
        Plan of the cohort.
    knees : int
        Number of knees, at least 4. Fewer knees are planned if the cohort has too few subjects of a grade.
    reference : str
        Name of the protocol to vary. With acquisition variability, each knee has its own variant of the protocol.
    axes : sequence of str
        Names of axes in `PROTOCOL_AXES`. The noise along an axis is independent of the selection of axes.

    Returns
    -------
    Plan
        Plan of the selected knees, with one exposure per axis and step.

    Raises
    ------
    InputError
        There are fewer than four knees, or the plan does not contain the protocol. The error is also raised if a step
        is outside the range of the field, or the grades allow no two-class task.
    """
    require_integer("curve_knees", knees, 4, 100_000, "knees")
    present = {case.knee.grade for case in plan.cases if case.knee.grade is not None}
    classes = TASKS[select_contrast(present)]
    chosen: list[Case] = []
    for grades in (tuple(present & set(one)) for one in classes):
        for place, grade in enumerate(sorted(grades)):
            taken = {case.subject for case in chosen}
            first = {case.subject: case for case in reversed(plan.cases) if case.knee.grade == grade}
            free = sorted((first[one] for one in first.keys() - taken), key=lambda case: case.index)
            chosen += free[: (knees // len(classes) + place) // len(grades)]
    cases = [_plan_case(plan.seed, case, reference, axes) for case in sorted(chosen, key=lambda case: case.index)]
    return Plan(preset=f"{plan.preset}, response curves", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases))


def _plan_case(seed: int, case: Case, reference: str, axes: Sequence[str]) -> Case:
    """Plan the exposures of one knee at every step of the selected axes."""
    known = {exposure.protocol.name: exposure.protocol for exposure in case.exposures}
    if reference not in known:
        raise InputError(f"protocol must be one of {', '.join(known)}, got {reference!r}")
    root = np.random.SeedSequence(seed, spawn_key=(case.index, _CURVE_STREAM))
    # Seeds are generated for all axes, so that the noise along an axis is independent of the selection of axes.
    states = iter(root.generate_state(sum(len(axis.steps) for axis in PROTOCOL_AXES.values()), np.uint64))
    exposures = []
    for name, axis in PROTOCOL_AXES.items():
        for turn, step in enumerate(axis.steps, start=1):
            noise = int(next(states) >> np.uint64(1))
            if name in axes:
                protocol = axis.vary(known[reference], step)
                label = f"{radiograph_stem(case.subject, case.index)}_{name}{turn}"
                exposures.append(
                    Exposure(label, protocol, noise, retest_kind=name, repeat_index=turn, source_knee=case.index)
                )
    return replace(case, exposures=tuple(exposures))
