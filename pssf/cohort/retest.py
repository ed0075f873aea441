"""Knees of a cohort that are taken again, as they stand and placed anew, for how stable a feature is."""

from dataclasses import replace

import numpy as np

from ..core.checks import require_choice
from ..model.protocol import Protocol
from .plan import Case, Exposure, Plan, stem

_RETEST = 4  # key of the streams under a knee's index, beside those of `plan`
# Off by which a knee is placed anew: what a careful radiographer is said to keep to (judgement).
_ROTATION_DEG, _FLEXION_DEG, _BEAM_DEG = 2.0, 2.0, 1.0


def plan_retest(plan: Plan, *, reference: str = "reference") -> Plan | None:
    """Knees of a cohort, one a subject and evenly over the grades, to be taken again under one protocol.

    Each is taken twice with other noise, and placed anew twice, to opposite sides: rotation and flexion off by 2 deg
    (flexion not below 0) and the beam by 1 deg, signs drawn, noise other again. The exposure says which it is. A knee
    that is placed anew is a case of its own, with an index beyond the plan's.

    returns  None where the plan retests no knee
    raises   InputError for a protocol that the plan does not have
    """
    if not plan.retested:
        return None
    protocols = {e.protocol.name: e.protocol for case in plan.cases for e in case.exposures}
    require_choice("protocol", reference, tuple(protocols))
    beyond = 1 + max(case.index for case in plan.cases)
    cases: list[Case] = []
    for case in _spread(plan):
        at = beyond + 2 * case.index
        cases += _retest(plan.seed, case, protocols[reference], at)
    # With masks, for they are few, and what finds the bone is held against the bone.
    return Plan(preset=f"{plan.preset}, retest", seed=plan.seed, repeats=plan.repeats, cases=tuple(cases), masks="tif")


def _spread(plan: Plan) -> list[Case]:
    """`plan.retested` cases, or as many as there are subjects: a grade after the other gives its next subject."""
    queues: dict[int | None, list[Case]] = {}
    seen: set[int] = set()
    for case in plan.cases:
        if case.subject not in seen:
            queues.setdefault(case.knee.grade, []).append(case)
            seen.add(case.subject)
    longest = max(len(queue) for queue in queues.values())
    turns = [queue[turn] for turn in range(longest) for queue in queues.values() if turn < len(queue)]
    return sorted(turns[: plan.retested], key=lambda case: case.index)


def _retest(seed: int, case: Case, protocol: Protocol, at: int) -> list[Case]:
    """The knee as it stands with other noise, and placed anew to one side and to the other."""
    root = np.random.SeedSequence(seed, spawn_key=(case.index, _RETEST))
    states = [int(state >> np.uint64(1)) for state in root.generate_state(4, np.uint64)]
    signs = np.random.default_rng(root.spawn(1)[0]).choice([-1.0, 1.0], 3)

    def exposure(kind: str, turn: int, protocol: Protocol, seed: int) -> Exposure:
        name = f"{stem(case.subject, case.index)}_{kind}{turn}"
        return Exposure(name, protocol, seed, kind, turn, of_knee=case.index)

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
        cases.append(replace(case, index=at + turn - 1, knee=knee, exposures=taken))
    return cases
