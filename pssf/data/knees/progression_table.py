"""Progression of osteoarthritis: annual changes of a knee by KL grade (``data/progress.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Numbers,
    Pair,
    Record,
    parse_record,
)

MeanSdByGrade = tuple[Pair, Pair, Pair, Pair, Pair]


class ProgressionThresholds(Record, frozen=True):
    """Osteophyte size thresholds for the KL grade of a knee with progressing osteoarthritis.

    The thresholds of joint space loss are in `oarsi_table.KellgrenLawrenceRule`.

    Attributes
    ----------
    doubtful_mm : float
        Smallest size of a doubtful osteophyte, in mm.
    definite_mm : tuple of float
        Smallest size of a definite osteophyte, per KL grade at the first visit, in mm.
    """

    doubtful_mm: float
    definite_mm: Numbers


class ProgressionRates(Record, frozen=True):
    """Annual changes of a knee, per KL grade 0 to 4 at the first visit. Pairs are mean and SD of a gamma distribution.

    Attributes
    ----------
    loss_mm : tuple of (float, float)
        Loss of joint space in the compartment that narrows, in mm per year.
    other_compartment_fraction : float
        Loss of joint space in the other compartment, relative to the compartment that narrows.
    medial : float
        Fraction of knees in which the medial compartment narrows, for grades below `narrowed_side_known_from_grade`.
    narrowed_side_known_from_grade : int
        Lowest KL grade at the first visit for which the compartment with the greater joint space loss continues to
        narrow.
    varus_deg_per_mm : float
        Change in alignment for each mm of difference in joint space loss between the compartments, in degrees per mm.
    osteophyte_mm : tuple of (float, float)
        Growth of osteophytes, in mm per year.
    growth_factor_range : (float, float)
        Range for uniform sampling of the growth factor of each osteophyte.
    new_osteophytes_per_year : tuple of float
        Rate at which a new osteophyte appears at a margin without an osteophyte, per year.
    most_mm : float
        Upper limit of the osteophyte size, in mm.
    least_mm : float
        Size below which a new osteophyte is not added to the knee, in mm.
    plate : tuple of (float, float)
        Thickening of the subchondral bone plate per year, relative to the thickness of a healthy plate.
    most_plate : float
        Upper limit of the subchondral bone plate thickness, relative to a healthy plate.
    notch_mm : tuple of (float, float)
        Growth of bone into the notch, in mm per year.
    most_notch_mm : float
        Upper limit of the bone growth into the notch, in mm.
    swelling_mm : tuple of (float, float)
        Increase in the thickness of capsule, synovium and fluid, in mm per year.
    most_swelling_mm : float
        Upper limit of the joint swelling, in mm.
    step : ProgressionThresholds
        Osteophyte size thresholds for the KL grade.
    """

    loss_mm: MeanSdByGrade
    other_compartment_fraction: float
    medial: float
    narrowed_side_known_from_grade: int
    varus_deg_per_mm: float
    osteophyte_mm: MeanSdByGrade
    growth_factor_range: Pair
    new_osteophytes_per_year: Numbers
    most_mm: float
    least_mm: float
    plate: MeanSdByGrade
    most_plate: float
    notch_mm: MeanSdByGrade
    most_notch_mm: float
    swelling_mm: MeanSdByGrade
    most_swelling_mm: float
    step: ProgressionThresholds


@cache
def load_progression_rates() -> ProgressionRates:
    """Load the annual rates of osteoarthritis progression.

    Returns
    -------
    ProgressionRates
        Content of ``data/progress.toml``.
    """
    return parse_record(ProgressionRates, load_data_table("progress"), "progress")
