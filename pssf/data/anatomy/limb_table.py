"""Limb thickness and subcutaneous fat by BMI and sex (``data/limbs.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record


class LimbMeasureByBmi(Record, frozen=True):
    """Limb measure whose mean increases linearly with BMI.

    Attributes
    ----------
    at_bmi : float
        BMI at which the mean is `mean_mm`, in kg/m2.
    mean_mm : dict of str to float
        Mean for each sex, in mm.
    mm_per_bmi : dict of str to float
        Increase of the mean with BMI for each sex, in mm per kg/m2.
    range_mm : (float, float)
        Lower and upper bound of the measure, in mm.
    """

    at_bmi: float
    mean_mm: dict[str, float]
    mm_per_bmi: dict[str, float]
    range_mm: Pair

    def mean_at_bmi(self, bmi: float, sex: str) -> float:
        """Compute the mean at a BMI, clipped to `range_mm`.

        Parameters
        ----------
        bmi : float
            BMI, in kg/m2.
        sex : {"male", "female"}
            Sex.

        Returns
        -------
        float
            Mean of the limb measure, in mm.
        """
        return self.clip_to_range(self.mean_mm[sex] + self.mm_per_bmi[sex] * (bmi - self.at_bmi))

    def clip_to_range(self, value_mm: float) -> float:
        """Clip a value to `range_mm`.

        Parameters
        ----------
        value_mm : float
            Value of the limb measure, in mm.

        Returns
        -------
        float
            Clipped value, in mm.
        """
        return round(min(max(value_mm, self.range_mm[0]), self.range_mm[1]), 4)


class LimbStatistics(Record, frozen=True):
    """Distribution of BMI, and dependence of limb measures on BMI.

    Attributes
    ----------
    bmi : (float, float)
        Mean and SD of BMI, in kg/m2.
    limb : dict of str to LimbMeasureByBmi
        BMI dependence of fields of `Knee`, keyed by field name.
    """

    bmi: Pair
    limb: dict[str, LimbMeasureByBmi]


@cache
def load_limb_statistics() -> LimbStatistics:
    """Load the limb statistics of the package.

    Returns
    -------
    LimbStatistics
        Content of ``data/limbs.toml``.
    """
    return parse_record(LimbStatistics, load_data_table("limbs"), "limbs")
