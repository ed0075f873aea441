"""Progress: how a knee changes in a year, by its KL grade, as `data/progress.toml` has it."""

from functools import cache

from .records import Numbers, Pair, Record, record
from .tables import data

Laws = tuple[Pair, Pair, Pair, Pair, Pair]


class Step(Record, frozen=True):
    """Sizes of osteophytes, mm, that make a KL grade of a knee as it ages; the rest is `oarsi.KellgrenLawrence`'s."""

    doubtful_mm: float
    definite_mm: Numbers


class Progress(Record, frozen=True):
    """Of a year: laws by grade, mean and deviation, of loss, growth, plate, notch and swelling; what they are
    shared and bounded by."""

    loss_mm: Laws
    other: float
    medial: float
    side_is_told: int
    varus_deg_per_mm: float
    osteophyte_mm: Laws
    of_each: Pair
    new_a_year: Numbers
    most_mm: float
    least_mm: float
    plate: Laws
    most_plate: float
    notch_mm: Laws
    most_notch_mm: float
    swelling_mm: Laws
    most_swelling_mm: float
    step: Step


@cache
def progress_law() -> Progress:
    """The package's table."""
    return record(Progress, data("progress"), "progress")
