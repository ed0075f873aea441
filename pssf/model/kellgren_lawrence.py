"""The KL grade of an anatomy: derived from osteophytes and joint space, and which grades an anatomy allows.

Kellgren and Lawrence (1957) grade pictures in words; the numbers that stand for the words are in `data/oarsi.toml`.
"""

from typing import TYPE_CHECKING

from ..core.checks import InputError
from ..data.grade_tables import grade_tables
from ..data.oarsi import OarsiCuts, oarsi_cuts

if TYPE_CHECKING:
    from .knee import Knee

SIDES = ("medial", "lateral")
MARGINS = ("medial_tibia", "medial_femur", "lateral_tibia", "lateral_femur")
MOST_GRADE = 4


def largest_osteophyte_mm(knee: "Knee") -> float:
    """Return the size of the largest osteophyte of a joint margin, in mm; 0 without one."""
    return max((one.size_mm for one in knee.osteophytes if one.site in MARGINS), default=0.0)


def narrowed(knee: "Knee", side: str, cuts: OarsiCuts) -> float:
    """Return the fraction of a healthy joint space that a compartment has lost."""
    return 1 - float(getattr(knee, f"jsw_{side}_mm")) / cuts.healthy(side, sex=knee.sex, jsw_as=knee.jsw_as)


def derive_grade(knee: "Knee", cuts: OarsiCuts) -> int:
    """Derive the KL grade of an anatomy (Kellgren and Lawrence 1957).

    0 without osteophytes and narrowing; 1 with a doubtful osteophyte or doubtful narrowing; 2 with a definite
    osteophyte; 3 and 4 with definite and severe narrowing besides. Severe narrowing without a definite osteophyte is 3
    or 4 too.
    """
    rule, largest = cuts.kellgren_lawrence, largest_osteophyte_mm(knee)
    lost = max(narrowed(knee, side, cuts) for side in SIDES)
    if largest >= rule.definite_mm:
        grade = 2 + sum(lost >= cut for cut in rule.lost)
    else:
        grade = int(largest > rule.doubtful_mm or lost >= cuts.narrowing[0])
    low, high = allowed_grades(knee, cuts)
    return min(max(grade, low), high)


def kl_grade(knee: "Knee", cuts: OarsiCuts) -> int:
    """Return the KL grade that a knee was sampled for, or the one derived from its anatomy."""
    return derive_grade(knee, cuts) if knee.grade is None else knee.grade


def allowed_grades(knee: "Knee", cuts: OarsiCuts) -> tuple[int, int]:
    """Return the lowest and the highest KL grade that do not contradict an anatomy.

    Grades overlap: readers differ, and a sampled knee has the grade that it was sampled for. An anatomy excludes a
    grade where its osteophytes or its joint space are beyond what knees of that grade have in any table of the package.
    """
    largest = largest_osteophyte_mm(knee)
    lost = max(narrowed(knee, side, cuts) for side in SIDES)
    osteophyte = sum(largest >= cut for cut in cuts.osteophyte_mm)
    narrowing = sum(lost >= cut for cut in cuts.narrowing)
    if not knee.osteophytes:
        return ((0, 1), (0, 2), (3, 3), (3, 4))[narrowing]
    low = max((0, 1, 2, 2)[osteophyte], (0, 0, 2, 3)[narrowing])
    high = max((2, 3, 3, 3)[osteophyte], (2, 3, 4, 4)[narrowing]) if osteophyte or narrowing else 2
    return low, 4 if osteophyte and narrowing else high


def require_grade(knee: "Knee") -> None:
    """Refuse a KL grade that contradicts the anatomy beside it.

    A table of the user's own defines what its grades are, so that its knees have the grade they were sampled for.

    Raises
    ------
    InputError
        With the grades that the anatomy allows.
    """
    if knee.grade is None or (knee.grade_table is not None and knee.grade_table not in grade_tables()):
        return
    cuts = oarsi_cuts()
    low, high = allowed_grades(knee, cuts)
    if low <= knee.grade <= high:
        return
    lost = ", ".join(f"{side} joint space narrowed by {100 * narrowed(knee, side, cuts):.0f} %" for side in SIDES)
    raise InputError(
        f"grade must be {low} to {high} for this anatomy (largest osteophyte {largest_osteophyte_mm(knee):g} mm, "
        f"{lost}), got {knee.grade}: leave it out to have it derived, or use draw_knee(grade={knee.grade})"
    )
