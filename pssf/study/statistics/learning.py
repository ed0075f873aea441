"""How many patients: AUC against the subjects learnt from, and the power to show a difference of a chosen size."""

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import chi2, nct
from scipy.stats import t as t_distribution

from ...core.checks import Array
from .intervals import error_of, estimate
from .ladder import QUESTIONS, paired, ratio_of, rungs

_LEVEL = 0.05
WANTED = 0.8  # power, as trials are planned for
_ASKED = ("do features do better than a measured joint space?", "do features add to a measured joint space?")
_POWER = [
    *("question", "grades", "rung", "minus", "difference", "subjects", "splits", "error", "power"),
    *("needed", "needed_low", "needed_high"),
]


def curves(splits: pd.DataFrame) -> pd.DataFrame:
    """`ladder.rungs` of several shares, the fewest subjects first, with what each step gained.

    splits   of `learn.ladder.climb`, of several shares
    returns  the columns of `ladder.rungs`, and gain, gain_low, gain_high: the difference of AUC from the next smaller
             share on the same tested subjects, with the variance of the smaller one; NaN of the smallest
    """
    table = rungs(splits).sort_values(["grades", "rung", "share"], kind="stable")
    table = table.drop_duplicates(["grades", "rung", "trained"], keep="last")
    rows = []
    for (grades, rung), part in table.groupby(["grades", "rung"], sort=False):
        of = splits[(splits["grades"] == grades) & (splits["rung"] == rung)]
        before = None
        for row in part.to_dict("records"):
            here = of[of["share"] == row["share"]].set_index("repeat")
            values = dict.fromkeys(("gain", "gain_low", "gain_high"), float("nan"))
            if before is not None:
                gain = estimate((here["auc"] - before["auc"]).to_numpy(np.float64), ratio_of(before))
                values = {"gain": gain.value, "gain_low": gain.low, "gain_high": gain.high}
            rows.append({**row, **values})
            before = here
    return pd.DataFrame(rows, columns=[*table.columns, "gain", "gain_low", "gain_high"])


def power_of(error: float, difference: float, splits: int) -> float:
    """Probability that a difference is shown at 5 %, two-sided, by the test of `intervals.estimate`.

    error       of the mean of so many splits, as `intervals.error_of` has it
    difference  that there is
    """
    return _power_at(abs(difference) / error, splits - 1)


def subjects_needed(error: float, difference: float, splits: int, subjects: int) -> float:
    """Subjects of a cohort in which a difference is shown with a power of 0.8.

    The variance of a split's difference is taken to fall as 1 over the subjects, so its error as 1 over their root.

    error     of the mean of so many splits of a cohort of so many subjects
    """
    shift = brentq(lambda errors: _power_at(errors, splits - 1) - WANTED, 0.1, 100.0)
    return subjects * float(shift * error / abs(difference)) ** 2


def _power_at(shift: float, free: int) -> float:
    """Of a t test with so many degrees of freedom, of a difference of so many errors."""
    beyond = float(t_distribution.ppf(1 - _LEVEL / 2, free))
    # Of the wrong sign it is less than 1e-8 beyond five errors, where the library's law may be no number.
    wrong = float(nct.cdf(-beyond, free, shift)) if shift < 5 else 0.0
    return float(nct.sf(beyond, free, shift)) + wrong


def spread_bounds(splits: int) -> tuple[float, float]:
    """Factors from a variance over splits to its 95 per cent interval (chi-square; exact for normal values that are all
    correlated alike, as those of overlapping splits are)."""
    free = splits - 1
    low, high = chi2.ppf([1 - _LEVEL / 2, _LEVEL / 2], free)
    return free / float(low), free / float(high)


def power(splits: pd.DataFrame, subjects: pd.Series, difference: float) -> pd.DataFrame:
    """What a cohort of this size can show, and how large one must be.

    splits      of `learn.ladder.climb`, learnt from all
    subjects    grades -> how many the cohort has of them
    difference  of AUC that is to be shown
    returns     question, grades, rung, minus, difference, subjects, splits, error (of the mean difference), power,
                needed, needed_low, needed_high: subjects of the two grades for a power of 0.8; a row a question and
                pair of grades whose splits differ, and where an AUC so much greater is at most 1
    """
    rows = []
    for question in _ASKED:
        one, other = QUESTIONS[question]
        for grades, part in splits.groupby("grades", sort=False):
            table = paired(part, one, other).dropna(subset="difference")
            if len(table) < 2 or np.ptp(table["difference"]) < 1e-12:
                continue
            if (table["auc"] - table["difference"]).mean() + difference > 1:
                continue
            count, error = len(table), error_of(table["difference"].to_numpy(np.float64), ratio_of(table))
            needed = subjects_needed(error, difference, count, int(subjects[grades]))
            low, high = (needed * factor for factor in spread_bounds(count))
            label = {"question": question, "grades": grades, "rung": one, "minus": other, "difference": difference}
            label |= {"subjects": int(subjects[grades]), "splits": count, "error": error}
            values = {"power": power_of(error, difference, count), "needed": needed}
            rows.append({**label, **values, "needed_low": low, "needed_high": high})
    return pd.DataFrame(rows, columns=_POWER)


def power_curve(row: pd.Series, subjects: Array) -> Array:
    """(n,) power in cohorts of other sizes.

    row       of `power`
    subjects  (n,) counts of the two grades
    """
    errors = row["error"] * np.sqrt(row["subjects"] / subjects)
    return np.array([power_of(error, row["difference"], int(row["splits"])) for error in errors])
