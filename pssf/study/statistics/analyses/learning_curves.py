"""Learning curves and sample size: AUC by number of training subjects, and power to show a difference of AUC."""

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import chi2, nct
from scipy.stats import t as t_distribution

from ....core.checks import Array
from ..scores.confidence_intervals import compute_standard_error, estimate_mean
from .incremental_value_scores import (
    QUESTIONS,
    average_test_train_ratio,
    pair_auc_differences,
    summarise_predictor_sets,
)

# Two-sided significance level of the tests.
_SIGNIFICANCE_LEVEL = 0.05
# Power for which the number of subjects is computed, as is usual for clinical trials.
TARGET_POWER = 0.8
# Questions of `QUESTIONS` for which the power is computed.
_POWER_QUESTIONS = ("do features predict better than measured JSW?", "do features add to measured JSW?")
_POWER_COLUMNS = [
    *("question", "grades", "rung", "minus", "difference", "subjects", "splits", "error", "power"),
    *("needed", "needed_low", "needed_high"),
]


def compute_learning_curves(splits: pd.DataFrame) -> pd.DataFrame:
    """Average the AUC of each predictor set by training fraction, with the gain of each step.

    Parameters
    ----------
    splits : DataFrame
        Results of `learn.incremental_value.evaluate_predictor_sets` with several training fractions.

    Returns
    -------
    DataFrame
        Columns of `summarise_predictor_sets`, and gain, gain_low, gain_high: difference of AUC from the next smaller
        fraction on the same test subjects, with the variance of the smaller one; NaN for the smallest. Fractions are in
        ascending order.
    """
    table = summarise_predictor_sets(splits).sort_values(["grades", "rung", "share"], kind="stable")
    table = table.drop_duplicates(["grades", "rung", "trained"], keep="last")
    rows = []
    for (grades, rung), part in table.groupby(["grades", "rung"], sort=False):
        of = splits[(splits["grades"] == grades) & (splits["rung"] == rung)]
        before = None
        for row in part.to_dict("records"):
            here = of[of["share"] == row["share"]].set_index("repeat")
            values = dict.fromkeys(("gain", "gain_low", "gain_high"), float("nan"))
            if before is not None:
                gain = estimate_mean(
                    (here["auc"] - before["auc"]).to_numpy(np.float64), average_test_train_ratio(before)
                )
                values = {"gain": gain.value, "gain_low": gain.low, "gain_high": gain.high}
            rows.append({**row, **values})
            before = here
    return pd.DataFrame(rows, columns=[*table.columns, "gain", "gain_low", "gain_high"])


def compute_power(error: float, difference: float, splits: int) -> float:
    """Compute the power to show a difference of AUC.

    The power is that of the test of `confidence_intervals.estimate_mean` at 5 %, two-sided.

    Parameters
    ----------
    error : float
        Standard error of the mean over the splits, of `compute_standard_error`.
    difference : float
        True difference of AUC.
    splits : int
        Number of splits.

    Returns
    -------
    float
        Power, a probability.
    """
    return _noncentral_t_power(abs(difference) / error, splits - 1)


def subjects_needed(error: float, difference: float, splits: int, subjects: int) -> float:
    """Compute the number of subjects for which a difference is shown with a power of 0.8.

    The variance of a difference is assumed to fall as 1 / subjects, so its standard error as 1 / sqrt(subjects).

    Parameters
    ----------
    error : float
        Standard error of the mean over the splits of this cohort.
    difference : float
        True difference of AUC.
    splits : int
        Number of splits.
    subjects : int
        Number of subjects of this cohort.

    Returns
    -------
    float
        Number of subjects.
    """
    shift = brentq(lambda errors: _noncentral_t_power(errors, splits - 1) - TARGET_POWER, 0.1, 100.0)
    return subjects * float(shift * error / abs(difference)) ** 2


def _noncentral_t_power(noncentrality: float, degrees_of_freedom: int) -> float:
    """Compute the power of a two-sided t test; `noncentrality` is the difference in standard errors."""
    beyond = float(t_distribution.ppf(1 - _SIGNIFICANCE_LEVEL / 2, degrees_of_freedom))
    # Beyond five standard errors, a result of the wrong sign has a probability below 1e-8, and scipy may return NaN.
    wrong = float(nct.cdf(-beyond, degrees_of_freedom, noncentrality)) if noncentrality < 5 else 0.0
    return float(nct.sf(beyond, degrees_of_freedom, noncentrality)) + wrong


def variance_interval_factors(splits: int) -> tuple[float, float]:
    """Compute the factors from a variance over splits to the ends of its 95 % interval (chi-square distribution).

    The factors are exact for normal values with equal correlations, as those of overlapping splits.

    Parameters
    ----------
    splits : int
        Number of splits.

    Returns
    -------
    tuple of float
        Lower and upper factor, dimensionless.
    """
    free = splits - 1
    low, high = chi2.ppf([1 - _SIGNIFICANCE_LEVEL / 2, _SIGNIFICANCE_LEVEL / 2], free)
    return free / float(low), free / float(high)


def tabulate_power(splits: pd.DataFrame, subjects: pd.Series, difference: float) -> pd.DataFrame:
    """Tabulate the power of this cohort and the number of subjects for a power of 0.8.

    Parameters
    ----------
    splits : DataFrame
        Results of `learn.incremental_value.evaluate_predictor_sets`, trained on all training subjects.
    subjects : Series
        Number of subjects of each pair of grades.
    difference : float
        Difference of AUC to show.

    Returns
    -------
    DataFrame
        One row per question and pair of grades whose splits differ and whose AUC plus the difference is at most 1.
        Columns: question, grades, rung, minus, difference, subjects, splits, error (standard error of the mean
        difference), power, needed, needed_low, needed_high (subjects of both grades for a power of 0.8).
    """
    rows = []
    for question in _POWER_QUESTIONS:
        one, other = QUESTIONS[question]
        for grades, part in splits.groupby("grades", sort=False):
            table = pair_auc_differences(part, one, other).dropna(subset="difference")
            if len(table) < 2 or np.ptp(table["difference"]) < 1e-12:
                continue
            if (table["auc"] - table["difference"]).mean() + difference > 1:
                continue
            count, error = (
                len(table),
                compute_standard_error(table["difference"].to_numpy(np.float64), average_test_train_ratio(table)),
            )
            needed = subjects_needed(error, difference, count, int(subjects[grades]))
            low, high = (needed * factor for factor in variance_interval_factors(count))
            label = {"question": question, "grades": grades, "rung": one, "minus": other, "difference": difference}
            label |= {"subjects": int(subjects[grades]), "splits": count, "error": error}
            values = {"power": compute_power(error, difference, count), "needed": needed}
            rows.append({**label, **values, "needed_low": low, "needed_high": high})
    return pd.DataFrame(rows, columns=_POWER_COLUMNS)


def compute_power_curve(row: pd.Series, subjects: Array) -> Array:
    """Compute the power in cohorts of other sizes.

    Parameters
    ----------
    row : Series
        Row of `tabulate_power`.
    subjects : (n,) float array, counts
        Numbers of subjects of both grades.

    Returns
    -------
    (n,) float array
        Power of each cohort, a probability.
    """
    errors = row["error"] * np.sqrt(row["subjects"] / subjects)
    return np.array([compute_power(error, row["difference"], int(row["splits"])) for error in errors])
