"""Contour landmarks on patient radiographs: statistics by KL grade (``data/landmarks.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Numbers,
    Pair,
    Record,
    Triple,
    parse_record,
)


class GradeLandmarkStatistics(Record, frozen=True):
    """Landmark statistics of one KL grade. Pairs are mean and SD.

    Lengths are in mm on the radiograph. Coordinates are fractions of the width of the tibial plateau.

    Attributes
    ----------
    knees : int
        Number of knees.
    plateau_width_mm : (float, float)
        Mean and SD of the width of the tibial plateau, in mm.
    medial_gap_least_mm : (float, float)
        Mean and SD of the smallest gap between femoral and tibial contour in the medial compartment, in mm.
    lateral_gap_least_mm : (float, float)
        Mean and SD of the smallest gap between femoral and tibial contour in the lateral compartment, in mm.
    medial_gap_at_0150_mm : (float, float)
        Mean and SD of the gap at 0.150 of the femoral width, measured from the medial edge of the femur, in mm.
    medial_gap_at_0200_mm : (float, float)
        Mean and SD of the gap at 0.200 of the femoral width, measured from the medial edge of the femur, in mm.
    medial_gap_at_0250_mm : (float, float)
        Mean and SD of the gap at 0.250 of the femoral width, measured from the medial edge of the femur, in mm.
    medial_gap_at_0300_mm : (float, float)
        Mean and SD of the gap at 0.300 of the femoral width, measured from the medial edge of the femur, in mm.
    joint_line_convergence_deg : (float, float)
        Mean and SD of the angle between the femoral and the tibial joint line, in degrees; positive if the joint is
        wider medially.
    mean_share : tuple of (float, float)
        Mean x and y of each landmark, as fractions of the plateau width.
    sd_share : tuple of (float, float)
        SD of x and y of each landmark, as fractions of the plateau width.
    """

    knees: int
    plateau_width_mm: Pair
    medial_gap_least_mm: Pair
    lateral_gap_least_mm: Pair
    medial_gap_at_0150_mm: Pair
    medial_gap_at_0200_mm: Pair
    medial_gap_at_0250_mm: Pair
    medial_gap_at_0300_mm: Pair
    joint_line_convergence_deg: Pair
    mean_share: tuple[Pair, ...]
    sd_share: tuple[Pair, ...]


class LandmarkModes(Record, frozen=True):
    """Principal components of the landmark coordinates.

    Attributes
    ----------
    share_of_variance : tuple of float
        Fraction of the total variance that each component explains.
    sd : tuple of float
        SD of the score of each component, as a fraction of the plateau width.
    vectors : tuple of tuple of float
        Unit vector of each component, in the order x and y of the first landmark, x and y of the second, and so on.
    """

    share_of_variance: Numbers
    sd: Numbers
    vectors: tuple[Numbers, ...]


class LandmarkReference(Record, frozen=True):
    """Statistics of contour landmarks on patient radiographs.

    Attributes
    ----------
    source : str
        Source of the annotations.
    names : tuple of str
        Names of the landmarks, in the order that all other attributes use.
    grade : dict of str to GradeLandmarkStatistics
        Statistics, keyed by KL grade as text.
    modes : LandmarkModes
        Principal components of knees with KL grade 0 or 1.
    gap_alone_auc : dict of str to (float, float, float)
        AUC for distinguishing grades 1 to 4 (keys "kl1" to "kl4") from grade 0 by the smallest gap of the narrower
        compartment. The values are the AUC and its 95 % confidence interval.
    """

    source: str
    names: tuple[str, ...]
    grade: dict[str, GradeLandmarkStatistics]
    modes: LandmarkModes
    gap_alone_auc: dict[str, Triple]


@cache
def load_landmark_reference() -> LandmarkReference:
    """Load the statistics of contour landmarks.

    Returns
    -------
    LandmarkReference
        Content of ``data/landmarks.toml``.
    """
    return parse_record(LandmarkReference, load_data_table("landmarks"), "landmarks")
