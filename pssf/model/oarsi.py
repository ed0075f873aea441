"""oarsi: a knee -> its OARSI grades by the names of the Osteoarthritis Initiative's readings."""

from collections.abc import Mapping

from ..data.oarsi import OarsiCuts
from ..data.records import Triple
from ..data.spongy import TrabecularBone
from .kellgren_lawrence import kl_grade, narrowed
from .knee import Knee

_BONES, _SIDES = {"femur": "F", "tibia": "T"}, {"medial": "M", "lateral": "L"}


def oarsi(knee: Knee, attrition_mm: Mapping[str, float], cuts: OarsiCuts, spongy: TrabecularBone) -> dict[str, int]:
    """Name -> grade 0 to 3: XROS.. osteophytes, XRJS. narrowing, XRSC.. sclerosis, XRATT. attrition. 0, 1: XRCY.. cysts

    F or T is the bone, M or L the side.
    attrition_mm  medial and lateral -> depth worn off the plateau, as `Truth` tells it; without, it is not graded
    spongy        how much of the plate's sclerosis each bone and side has

    Grades are of what the knee is built with, not of what can be seen of it under a protocol; their cuts are in
    `data/oarsi.toml` (Altman and Gold 2007; judgement). XRKL is the KL grade that the knee was sampled for, or the one
    derived from its anatomy (`kellgren_lawrence`).
    """
    grades = {"XRKL": kl_grade(knee, cuts)}
    for bone, letter in _BONES.items():
        for side, of_side in _SIDES.items():
            sizes = [one.size_mm for one in knee.osteophytes if one.site == f"{side}_{bone}"]
            grades[f"XROS{letter}{of_side}"] = _grade(max(sizes, default=0.0), cuts.osteophyte_mm)
    for side, of_side in _SIDES.items():
        grades[f"XRJS{of_side}"] = _grade(narrowed(knee, side, cuts), cuts.narrowing)
    for bone, letter in _BONES.items():
        for side, of_side in _SIDES.items():
            share = getattr(spongy, bone).sclerosis
            share *= 1.0 if side == knee.sclerotic_side else spongy.sclerosis.other_side
            grades[f"XRSC{letter}{of_side}"] = _grade(1 + share * (knee.subchondral_plate - 1), cuts.plate)
    for bone, letter in _BONES.items():
        for side, of_side in _SIDES.items():
            grades[f"XRCY{letter}{of_side}"] = int(any(one.site == f"{side}_{bone}" for one in knee.cysts))
    worn = {f"XRATT{_SIDES[side]}": _grade(depth, cuts.attrition_mm) for side, depth in attrition_mm.items()}
    return grades | worn


def _grade(value: float, cuts: Triple) -> int:
    return sum(value >= cut for cut in cuts)
