"""LimbLaw: what a person's BMI gives a limb, as `data/limbs.toml` has it."""

from functools import cache

from .records import Pair, Record, record
from .tables import data


class LimbLaw(Record, frozen=True):
    """A measure of the limb, whose mean grows with BMI.

    at_bmi      of which `mean_mm` is the mean
    mean_mm     of each sex
    mm_per_bmi  growth of the mean, of each sex
    range_mm    that it is held within
    """

    at_bmi: float
    mean_mm: dict[str, float]
    mm_per_bmi: dict[str, float]
    range_mm: Pair

    def mean(self, bmi: float, sex: str) -> float:
        """mm, of people of a sex at a BMI (kg/m2)"""
        return self.held(self.mean_mm[sex] + self.mm_per_bmi[sex] * (bmi - self.at_bmi))

    def held(self, value_mm: float) -> float:
        """A value, or the end of the range that it is beyond, mm."""
        return round(min(max(value_mm, self.range_mm[0]), self.range_mm[1]), 4)


class Limbs(Record, frozen=True):
    """Mean and standard deviation of BMI, kg/m2, and field of a knee -> its mean by BMI."""

    bmi: Pair
    limb: dict[str, LimbLaw]


@cache
def limbs() -> Limbs:
    """What the package knows of limbs."""
    return record(Limbs, data("limbs"), "limbs")
