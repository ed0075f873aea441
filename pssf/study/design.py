"""Knees taken again with one thing of a protocol changed at a time: a plan of response curves.

Each step has noise of its own, so that a feature's agreement with the cohort's radiograph holds what noise does at that
step. What an axis changes beside its own field keeps the others apart: see AXES.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cohort.plan import Case, Exposure, Plan, stem
from ..core.checks import InputError, require_whole
from ..model.protocol import Protocol
from .tasks import TASKS, contrast_of

if TYPE_CHECKING:
    import pandas as pd

# Key of the stream under a knee's index, beside those of `cohort.plan`.
_CURVES = 6
# A radiographer halves mAs for 15 % more kV (Bushong, Radiologic Science for Technologists; from memory).
_KV_EXPONENT = np.log(2) / np.log(1.15)


@dataclass(frozen=True, kw_only=True)
class Designed:
    """Manifests of radiographs that were taken by design, None where there are none; kind and turn say what each is.

    curves  of `plan_curves`
    shares  of `space.plan_shares`, of so many samples
    pairs   of `space.plan_pairs`
    bounds  of `space.bounds_of`
    """

    curves: "pd.DataFrame | None" = None
    shares: "pd.DataFrame | None" = None
    samples: int = 0
    pairs: "pd.DataFrame | None" = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def manifests(self) -> "list[pd.DataFrame]":
        """Those that there are."""
        return [table for table in (self.curves, self.shares, self.pairs) if table is not None]


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One thing of a protocol that is changed.

    label    as it is written under a curve, with what a step is relative to
    how      "factor": of the protocol's own value; "offset": added to it
    steps    seven, the protocol's own (1 or 0) among them
    scale    "linear" or "log": how a step is drawn, and what lies between two is read off
    others   protocol, its value at a step -> fields that change with it
    """

    label: str
    field: str
    how: str
    steps: tuple[float, ...]
    scale: str = "linear"
    others: Callable[[Protocol, float], dict[str, Any]] = lambda protocol, value: {}

    @property
    def own(self) -> float:
        """The step that changes nothing."""
        return 1.0 if self.how == "factor" else 0.0

    def varied(self, protocol: Protocol, step: float) -> Protocol:
        """The protocol at a step.

        raises  InputError where the value leaves what the field may be
        """
        before = getattr(protocol, self.field)
        value = round(before * step if self.how == "factor" else before + step, 6)
        return replace(protocol, **{self.field: value, **self.others(protocol, value)})


def _same_exposure(protocol: Protocol, tube_kv: float) -> dict[str, Any]:
    return {"mas": round(protocol.mas * (protocol.tube_kv / tube_kv) ** float(_KV_EXPONENT), 4)}


def _same_field(protocol: Protocol, pixel_mm: float) -> dict[str, Any]:
    return {name: round(getattr(protocol, name) * protocol.pixel_mm / pixel_mm) for name in ("rows", "cols")}


def _same_kerma(protocol: Protocol, sdd_mm: float) -> dict[str, Any]:
    mas = round(protocol.mas * (sdd_mm / protocol.sdd_mm) ** 2, 4)
    return {"sod_mm": round(sdd_mm - (protocol.sdd_mm - protocol.sod_mm), 4), "mas": mas}


# Those of one geometry first, whose rays are traced once; the last one turns the leg, which is built anew.
AXES = {
    "dose": Axis(
        label="dose (factor of mAs)",
        field="mas",
        how="factor",
        steps=(1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0),
        scale="log",
    ),
    "kv": Axis(
        label="tube voltage (kV more; mAs by the 15 % rule)",
        field="tube_kv",
        how="offset",
        steps=(-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 20.0),
        others=_same_exposure,
    ),
    "focal_spot": Axis(
        label="focal spot (factor of its width)", field="focal_spot_mm", how="factor", steps=(0.0, 0.5, 1, 1.5, 2, 3, 4)
    ),
    "scatter": Axis(
        label="grid ratio more (less scatter; same mAs)",
        field="grid_ratio",
        how="offset",
        steps=(0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0),
    ),
    "pixel_size": Axis(
        label="pixel (factor of its side; same field)",
        field="pixel_mm",
        how="factor",
        steps=(2 / 3, 1.0, 4 / 3, 5 / 3, 2.0, 8 / 3, 10 / 3),
        others=_same_field,
    ),
    "distance": Axis(
        label="distance of the source (factor; same kerma at the detector)",
        field="sdd_mm",
        how="factor",
        steps=(0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3),
        others=_same_kerma,
    ),
    "tilt": Axis(
        label="tilt of the beam (deg more)",
        field="beam_angle_deg",
        how="offset",
        steps=(-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0),
    ),
    "rotation": Axis(
        label="rotation of the leg (deg more)",
        field="rotation_deg",
        how="offset",
        steps=(-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0),
    ),
}


def plan_curves(plan: Plan, *, knees: int, reference: str, axes: Sequence[str] = tuple(AXES)) -> Plan:
    """Knees of a cohort, one a subject, taken at every step of every axis: half of grade 0, half of the others of the
    contrast (`tasks.contrast_of`), which are alike in number.

    An exposure's kind is its axis, its turn the number of the step from 1.

    knees      in all; fewer where the cohort has not so many subjects of a grade
    reference  protocol of the plan that is varied, as each knee was taken by it
    raises     InputError for fewer than four knees, a protocol that the plan does not have or that cannot be so varied,
               or a plan whose grades make no contrast
    """
    require_whole("curves", knees, 4, 100_000, "knees")
    present = {case.knee.grade for case in plan.cases if case.knee.grade is not None}
    classes = TASKS[contrast_of(present)]
    chosen: list[Case] = []
    for grades in (tuple(present & set(one)) for one in classes):
        for place, grade in enumerate(sorted(grades)):
            taken = {case.subject for case in chosen}
            first = {case.subject: case for case in reversed(plan.cases) if case.knee.grade == grade}
            free = sorted((first[one] for one in first.keys() - taken), key=lambda case: case.index)
            chosen += free[: (knees // len(classes) + place) // len(grades)]
    cases = [_taken(plan.seed, case, reference, axes) for case in sorted(chosen, key=lambda case: case.index)]
    return Plan(preset=f"{plan.preset}, curves", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases))


def _taken(seed: int, case: Case, reference: str, axes: Sequence[str]) -> Case:
    known = {exposure.protocol.name: exposure.protocol for exposure in case.exposures}
    if reference not in known:
        raise InputError(f"protocol = {reference!r}; allowed: {', '.join(known)}")
    root = np.random.SeedSequence(seed, spawn_key=(case.index, _CURVES))
    # All axes draw, so that leaving one out leaves the others as they are.
    states = iter(root.generate_state(sum(len(axis.steps) for axis in AXES.values()), np.uint64))
    exposures = []
    for name, axis in AXES.items():
        for turn, step in enumerate(axis.steps, start=1):
            noise = int(next(states) >> np.uint64(1))
            if name in axes:
                protocol = axis.varied(known[reference], step)
                label = f"{stem(case.subject, case.index)}_{name}{turn}"
                exposures.append(Exposure(label, protocol, noise, kind=name, turn=turn, of_knee=case.index))
    return replace(case, exposures=tuple(exposures))
