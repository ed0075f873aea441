"""LandmarkReference: where contour landmarks lie on films of people, as `data/landmarks.toml` has it."""

from functools import cache

from .records import Numbers, Pair, Record, Triple, record
from .tables import data


class GradeContours(Record, frozen=True):
    """Contours of one KL grade: pairs of mean and SD, in film mm and deg; mean and SD of each landmark's x and y."""

    knees: int
    plateau_width_mm: Pair
    medial_gap_least_mm: Pair
    lateral_gap_least_mm: Pair
    medial_gap_at_0150_mm: Pair
    medial_gap_at_0200_mm: Pair
    medial_gap_at_0250_mm: Pair
    medial_gap_at_0300_mm: Pair
    lines_converge_deg: Pair
    mean_share: tuple[Pair, ...]
    sd_share: tuple[Pair, ...]


class ContourModes(Record, frozen=True):
    """Principal components of all shares: of the variance, standard deviations, and unit vectors."""

    share_of_variance: Numbers
    sd: Numbers
    vectors: tuple[Numbers, ...]


class LandmarkReference(Record, frozen=True):
    """All of `data/landmarks.toml`.

    names          of the landmarks, in order
    grade          KL grade, as text, -> its contours
    modes          of grades 0 and 1 together
    gap_alone_auc  grade -> AUC of the smaller least gap against grade 0, with its interval
    """

    source: str
    names: tuple[str, ...]
    grade: dict[str, GradeContours]
    modes: ContourModes
    gap_alone_auc: dict[str, Triple]


@cache
def landmark_reference() -> LandmarkReference:
    """Statistics of people's contour landmarks."""
    return record(LandmarkReference, data("landmarks"), "landmarks")
