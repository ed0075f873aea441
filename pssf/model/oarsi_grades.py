"""Compute the OARSI grades of a knee, with the variable names of the Osteoarthritis Initiative."""

from collections.abc import Mapping

from ..data.anatomy.trabecular_table import TrabecularBone
from ..data.knees.oarsi_table import OarsiThresholds
from ..data.table_records import Triple
from .kellgren_lawrence import kl_grade, narrowing_fraction
from .knee import Knee

# Letters for bones and compartments in the variable names of the Osteoarthritis Initiative.
_BONES = {"femur": "F", "tibia": "T"}
_SIDES = {"medial": "M", "lateral": "L"}


def compute_oarsi_grades(
    knee: Knee, attrition_mm: Mapping[str, float], cuts: OarsiThresholds, trabecular_bone: TrabecularBone
) -> dict[str, int]:
    """Compute the OARSI grades of a knee from its parameters (Altman and Gold 2007).

    Parameters
    ----------
    knee : Knee
        Knee to grade.
    attrition_mm : mapping of str to float
        Attrition depth of the medial and lateral plateau, in mm, as in `Truth.attrition_mm`. A compartment without a
        depth gets no attrition grade.
    cuts : OarsiThresholds
        Lower thresholds of grades 1, 2 and 3 for every sign.
    trabecular_bone : TrabecularBone
        Trabecular bone table, which specifies the fraction of `Knee.subchondral_plate` thickening in each bone and
        compartment.

    Returns
    -------
    dict of str to int
        ``XRKL`` is the KL grade. ``XROS..`` (osteophytes), ``XRJS.`` (joint space narrowing), ``XRSC..`` (sclerosis)
        and ``XRATT.`` (attrition) are grades 0 to 3. ``XRCY..`` is 1 with a subchondral cyst and 0 without. Each dot
        represents a letter: F for femur or T for tibia, and M for medial or L for lateral.

    Notes
    -----
    The grades describe the anatomy, not its visibility on a radiograph. The thresholds are in ``data/oarsi.toml``.
    The OARSI atlas defines grades by example radiographs, so the numerical thresholds are assumed. ``XRKL`` is the
    result of `kellgren_lawrence.kl_grade`.
    """
    grades = {"XRKL": kl_grade(knee, cuts)}
    for bone, letter in _BONES.items():
        for side, of_side in _SIDES.items():
            sizes = [one.size_mm for one in knee.osteophytes if one.site == f"{side}_{bone}"]
            grades[f"XROS{letter}{of_side}"] = _grade_by_cuts(max(sizes, default=0.0), cuts.osteophyte_mm)
    for side, of_side in _SIDES.items():
        grades[f"XRJS{of_side}"] = _grade_by_cuts(narrowing_fraction(knee, side, cuts), cuts.narrowing)
    for bone, letter in _BONES.items():
        for side, of_side in _SIDES.items():
            share = getattr(trabecular_bone, bone).sclerosis
            share *= 1.0 if side == knee.sclerotic_side else trabecular_bone.sclerosis.other_side
            grades[f"XRSC{letter}{of_side}"] = _grade_by_cuts(1 + share * (knee.subchondral_plate - 1), cuts.plate)
    for bone, letter in _BONES.items():
        for side, of_side in _SIDES.items():
            grades[f"XRCY{letter}{of_side}"] = int(any(one.site == f"{side}_{bone}" for one in knee.cysts))
    worn = {f"XRATT{_SIDES[side]}": _grade_by_cuts(depth, cuts.attrition_mm) for side, depth in attrition_mm.items()}
    return grades | worn


def _grade_by_cuts(value: float, cuts: Triple) -> int:
    """Grade a value from 0 to 3 by the number of thresholds that it reaches."""
    return sum(value >= cut for cut in cuts)
