"""Kellgren-Lawrence (KL) grades of an anatomy: the grade that follows from it, and the grades that it allows.

Kellgren and Lawrence (1957) define the grades in words and pictures. The numbers that replace the words are in
``data/oarsi.toml``.
"""

from typing import TYPE_CHECKING

from ..core.checks import InputError
from ..data.knees.grade_tables import list_grade_tables
from ..data.knees.oarsi_table import OarsiThresholds, load_oarsi_thresholds

if TYPE_CHECKING:
    from .knee import Knee

# Compartments of the tibiofemoral joint.
SIDES = ("medial", "lateral")
# Joint margins, whose osteophytes count for the KL grade.
MARGINS = ("medial_tibia", "medial_femur", "lateral_tibia", "lateral_femur")
# Highest KL grade (Kellgren and Lawrence 1957).
MAX_GRADE = 4


def largest_osteophyte_mm(knee: "Knee") -> float:
    """Return the size of the largest osteophyte at a joint margin.

    Parameters
    ----------
    knee : Knee
        The anatomy.

    Returns
    -------
    float
        Size in mm; 0 without a marginal osteophyte.
    """
    return max((one.size_mm for one in knee.osteophytes if one.site in MARGINS), default=0.0)


def narrowing_fraction(knee: "Knee", side: str, cuts: OarsiThresholds) -> float:
    """Return the fraction of a healthy joint space that a compartment has lost.

    Parameters
    ----------
    knee : Knee
        The anatomy.
    side : {"medial", "lateral"}
        Compartment.
    cuts : OarsiThresholds
        Table with the healthy joint space of each compartment and sex.

    Returns
    -------
    float
        1 minus the joint space over the healthy one; negative if the joint space is wider than a healthy one.
    """
    return 1 - float(getattr(knee, f"jsw_{side}_mm")) / cuts.healthy_jsw_mm(
        side, sex=knee.sex, jsw_definition=knee.jsw_definition
    )


def derive_grade(knee: "Knee", cuts: OarsiThresholds) -> int:
    """Derive the KL grade of an anatomy (Kellgren and Lawrence 1957).

    Grade 0 has neither osteophytes nor narrowing. Grade 1 has a doubtful osteophyte or doubtful narrowing. Grade 2 has
    a definite osteophyte. Grades 3 and 4 have a definite osteophyte with definite and severe narrowing. Severe
    narrowing without a definite osteophyte is grade 3 or 4 too.

    Parameters
    ----------
    knee : Knee
        The anatomy.
    cuts : OarsiThresholds
        Sizes of osteophytes and fractions of lost joint space that separate the grades.

    Returns
    -------
    int
        KL grade, 0 to 4.
    """
    rule, largest = cuts.kellgren_lawrence, largest_osteophyte_mm(knee)
    lost = max(narrowing_fraction(knee, side, cuts) for side in SIDES)
    if largest >= rule.definite_mm:
        grade = 2 + sum(lost >= cut for cut in rule.jsw_loss_fractions)
    else:
        grade = int(largest > rule.doubtful_mm or lost >= cuts.narrowing[0])
    low, high = allowed_grades(knee, cuts)
    return min(max(grade, low), high)


def kl_grade(knee: "Knee", cuts: OarsiThresholds) -> int:
    """Return the KL grade that a knee was sampled for, or the grade derived from its anatomy.

    Parameters
    ----------
    knee : Knee
        The anatomy; `Knee.grade` is used if it is not None.
    cuts : OarsiThresholds
        Thresholds for the derived grade.

    Returns
    -------
    int
        KL grade, 0 to 4.
    """
    return derive_grade(knee, cuts) if knee.grade is None else knee.grade


def allowed_grades(knee: "Knee", cuts: OarsiThresholds) -> tuple[int, int]:
    """Return the lowest and the highest KL grade that do not contradict an anatomy.

    Grades overlap: readers differ, and a sampled knee has the grade that it was sampled for. An anatomy excludes a
    grade if no table of the package has such osteophytes or such a joint space in knees of that grade.

    Parameters
    ----------
    knee : Knee
        The anatomy.
    cuts : OarsiThresholds
        Thresholds of osteophyte size and joint space loss.

    Returns
    -------
    low : int
        Lowest KL grade that is allowed.
    high : int
        Highest KL grade that is allowed.
    """
    largest = largest_osteophyte_mm(knee)
    lost = max(narrowing_fraction(knee, side, cuts) for side in SIDES)
    osteophyte = sum(largest >= cut for cut in cuts.osteophyte_mm)
    narrowing = sum(lost >= cut for cut in cuts.narrowing)
    if not knee.osteophytes:
        return ((0, 1), (0, 2), (3, 3), (3, 4))[narrowing]
    low = max((0, 1, 2, 2)[osteophyte], (0, 0, 2, 3)[narrowing])
    high = max((2, 3, 3, 3)[osteophyte], (2, 3, 4, 4)[narrowing]) if osteophyte or narrowing else 2
    return low, 4 if osteophyte and narrowing else high


def require_grade(knee: "Knee") -> None:
    """Check that the KL grade of a knee does not contradict its anatomy.

    A knee without a grade passes. So does a knee from a user's own grade table, which defines its grades itself.

    Parameters
    ----------
    knee : Knee
        The knee to check.

    Raises
    ------
    InputError
        If the anatomy excludes the grade; the message names the allowed grades.
    """
    if knee.grade is None or (knee.grade_table is not None and knee.grade_table not in list_grade_tables()):
        return
    cuts = load_oarsi_thresholds()
    low, high = allowed_grades(knee, cuts)
    if low <= knee.grade <= high:
        return
    lost = ", ".join(
        f"{side} joint space narrowed by {100 * narrowing_fraction(knee, side, cuts):.0f} %" for side in SIDES
    )
    raise InputError(
        f"grade must be {low} to {high} for this anatomy (largest osteophyte {largest_osteophyte_mm(knee):g} mm, "
        f"{lost}), got {knee.grade}: leave it out to have it derived, or use sample_knee(grade={knee.grade})"
    )
