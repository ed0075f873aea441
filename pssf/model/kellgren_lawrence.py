"""Derive the Kellgren-Lawrence (KL) grade and the range of allowed KL grades from the anatomy of a knee.

Kellgren and Lawrence (1957) define the grades in words and pictures. This package uses the numerical thresholds in
``data/oarsi.toml`` instead.
"""

from typing import TYPE_CHECKING

from ..core.checks import InputError
from ..data.knees.grade_tables import list_grade_tables
from ..data.knees.oarsi_table import OarsiThresholds, load_oarsi_thresholds

if TYPE_CHECKING:
    from .knee import Knee

# Compartments of the tibiofemoral joint.
SIDES = ("medial", "lateral")
# Joint margins; only marginal osteophytes affect the KL grade.
MARGINS = ("medial_tibia", "medial_femur", "lateral_tibia", "lateral_femur")
# Highest KL grade (Kellgren and Lawrence 1957).
MAX_GRADE = 4


def largest_osteophyte_mm(knee: "Knee") -> float:
    """Return the size of the largest osteophyte at a joint margin.

    Parameters
    ----------
    knee : Knee
        Knee whose anatomy is evaluated.

    Returns
    -------
    float
        Size in mm; 0 if the knee has no marginal osteophyte.
    """
    return max((one.size_mm for one in knee.osteophytes if one.site in MARGINS), default=0.0)


def narrowing_fraction(knee: "Knee", side: str, cuts: OarsiThresholds) -> float:
    """Compute the fraction of the healthy joint space width that a compartment has lost.

    Parameters
    ----------
    knee : Knee
        Knee whose anatomy is evaluated.
    side : {"medial", "lateral"}
        Compartment.
    cuts : OarsiThresholds
        Grading thresholds, which include the healthy joint space width of each compartment and sex.

    Returns
    -------
    float
        1 minus the ratio of the joint space width to the healthy joint space width; negative for a wider joint space.
    """
    return 1 - float(getattr(knee, f"jsw_{side}_mm")) / cuts.healthy_jsw_mm(
        side, sex=knee.sex, jsw_definition=knee.jsw_definition
    )


def derive_grade(knee: "Knee", cuts: OarsiThresholds) -> int:
    """Derive the KL grade from the anatomy of a knee (Kellgren and Lawrence 1957).

    Grade 0 has neither osteophytes nor narrowing. Grade 1 has a doubtful osteophyte or doubtful narrowing. Grade 2 has
    a definite osteophyte. Grade 3 has a definite osteophyte with definite narrowing, and grade 4 has a definite
    osteophyte with severe narrowing. Severe narrowing without a definite osteophyte is also grade 3 or 4.

    Parameters
    ----------
    knee : Knee
        Knee whose anatomy is evaluated.
    cuts : OarsiThresholds
        Thresholds between the grades for osteophyte size and joint space loss.

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
    """Return the requested KL grade of a sampled knee, or the grade derived from the anatomy of any other knee.

    Parameters
    ----------
    knee : Knee
        Knee to grade. `Knee.grade` is used if it is not None.
    cuts : OarsiThresholds
        Thresholds between the grades for osteophyte size and joint space loss.

    Returns
    -------
    int
        KL grade, 0 to 4.
    """
    return derive_grade(knee, cuts) if knee.grade is None else knee.grade


def allowed_grades(knee: "Knee", cuts: OarsiThresholds) -> tuple[int, int]:
    """Return the lowest and highest KL grade that are consistent with the anatomy of a knee.

    The grades overlap, because readers disagree and because a sampled knee keeps its requested grade. An anatomy
    excludes a grade if no built-in grade table contains the osteophytes of the anatomy, or its joint space widths, in
    knees with that grade.

    Parameters
    ----------
    knee : Knee
        Knee whose anatomy is evaluated.
    cuts : OarsiThresholds
        Thresholds between the grades for osteophyte size and joint space loss.

    Returns
    -------
    low : int
        Lowest allowed KL grade.
    high : int
        Highest allowed KL grade.
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

    Knees without a grade are not checked. Knees from a user-defined grade table are not checked either, because a user
    table defines its own grades.

    Parameters
    ----------
    knee : Knee
        Knee to check.

    Raises
    ------
    InputError
        If the anatomy excludes the grade. The error message lists the allowed grades.
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
        f"{lost}), got {knee.grade}: omit grade to derive it from the anatomy, or use sample_knee(grade={knee.grade})"
    )
