"""Plan repeat radiographs of selected knees of a cohort, to measure the reliability of features."""

from dataclasses import replace

import numpy as np

from ..core.checks import require_choice
from ..model.protocol import Protocol
from .cohort_plan import (
    Case,
    Exposure,
    Plan,
    radiograph_stem,
)

# Key of the random stream of repeat radiographs; `cohort_plan` defines the other keys.
_RETEST_STREAM = 4
# Change of rotation on repositioning, in degrees (assumed: the precision of a careful radiographer).
_ROTATION_DEG = 2.0
# Change of flexion on repositioning, in degrees (assumed: the precision of a careful radiographer).
_FLEXION_DEG = 2.0
# Change of beam angle on repositioning, in degrees (assumed: the precision of a careful radiographer).
_BEAM_DEG = 1.0


def plan_retest(plan: Plan, *, reference: str = "reference") -> Plan | None:
    """Plan repeat radiographs of selected knees of a cohort with one protocol.

    The knees are balanced over the grades, with one knee per subject. Each knee is imaged twice with new noise only,
    and twice with new noise after repositioning in opposite directions. Repositioning changes rotation and flexion by 2
    degrees and the beam angle by 1 degree, with random signs. Negative flexion is set to 0.

    Parameters
    ----------
    plan : Plan
        Plan of the cohort; `plan.retested` is the number of knees to image again.
    reference : str, default "reference"
        Name of the protocol for the repeat radiographs.

    Returns
    -------
    Plan or None
        Plan of the repeat radiographs, with masks. `Exposure.retest_kind` is "noise" or "perturbation". A repositioned
        knee is a separate case, whose index is larger than all indices of `plan`. None if `plan.retested` is 0.

    Raises
    ------
    InputError
        If `reference` is not a protocol of the plan.
    """
    if not plan.retested:
        return None
    protocols = {e.protocol.name: e.protocol for case in plan.cases for e in case.exposures}
    require_choice("protocol", reference, tuple(protocols))
    beyond = 1 + max(case.index for case in plan.cases)
    cases: list[Case] = []
    for case in _select_balanced_cases(plan):
        at = beyond + 2 * case.index
        cases += _make_retest_cases(plan.seed, case, protocols[reference], at)
    # Masks are saved, because the study compares segmented bones with the masks of the few repeat radiographs.
    return Plan(preset=f"{plan.preset}, retest", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases), masks="tif")


def _select_balanced_cases(plan: Plan) -> list[Case]:
    """Select `plan.retested` cases, at most one per subject; cycle through the grades in the order of the subjects."""
    queues: dict[int | None, list[Case]] = {}
    seen: set[int] = set()
    for case in plan.cases:
        if case.subject not in seen:
            queues.setdefault(case.knee.grade, []).append(case)
            seen.add(case.subject)
    longest = max(len(queue) for queue in queues.values())
    turns = [queue[turn] for turn in range(longest) for queue in queues.values() if turn < len(queue)]
    return sorted(turns[: plan.retested], key=lambda case: case.index)


def _make_retest_cases(seed: int, case: Case, protocol: Protocol, first_index: int) -> list[Case]:
    """Make the cases of one knee: two radiographs with new noise, two after repositioning in opposite directions."""
    root = np.random.SeedSequence(seed, spawn_key=(case.index, _RETEST_STREAM))
    states = [int(state >> np.uint64(1)) for state in root.generate_state(4, np.uint64)]
    signs = np.random.default_rng(root.spawn(1)[0]).choice([-1.0, 1.0], 3)

    def exposure(kind: str, turn: int, protocol: Protocol, seed: int) -> Exposure:
        """Plan one repeat radiograph of the knee."""
        name = f"{radiograph_stem(case.subject, case.index)}_{kind}{turn}"
        return Exposure(name, protocol, seed, kind, turn, source_knee=case.index)

    cases = [replace(case, exposures=tuple(exposure("noise", k, protocol, states[k - 1]) for k in (1, 2)))]
    for turn, side in ((1, 1.0), (2, -1.0)):
        rotation, flexion, beam = (float(side * sign) for sign in signs)
        knee = replace(
            case.knee,
            rotation_deg=round(case.knee.rotation_deg + rotation * _ROTATION_DEG, 4),
            flexion_deg=round(max(0.0, case.knee.flexion_deg + flexion * _FLEXION_DEG), 4),
        )
        placed = replace(protocol, beam_angle_deg=protocol.beam_angle_deg + beam * _BEAM_DEG)
        taken = (exposure("perturbation", turn, placed, states[turn + 1]),)
        cases.append(replace(case, index=first_index + turn - 1, knee=knee, exposures=taken))
    return cases
