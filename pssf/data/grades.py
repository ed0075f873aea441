"""GradeRanges: what a drawn knee of a grade may be, as `data/grades.toml` has it."""

from functools import cache

from .records import Pair, Record, record
from .tables import data


class GradeRanges(Record, frozen=True):
    """Bounds of what is drawn evenly; mm, degrees, the plate relative to a healthy one."""

    jsw_medial_mm: Pair
    jsw_lateral_mm: Pair
    osteophyte_count: tuple[int, int]
    largest_osteophyte_mm: Pair
    subchondral_plate: Pair
    varus_deg: Pair


class Fabellae(Record, frozen=True):
    """Share of knees that have a fabella, and bounds of its size."""

    share: float
    size_mm: Pair


class Grades(Record, frozen=True):
    """All of a table of grades.

    grade  name -> its ranges
    body   field of a knee -> mean and standard deviation, of both sexes or of each
    pose   field of a knee -> bounds
    form   as body, of what is drawn with the scores of the shape
    """

    grade: dict[str, GradeRanges]
    body: dict[str, Pair | dict[str, Pair]]
    pose: dict[str, Pair]
    form: dict[str, Pair | dict[str, Pair]]
    fabella: Fabellae


@cache
def grades() -> Grades:
    """The package's table of grades."""
    return record(Grades, data("grades"), "grades")
