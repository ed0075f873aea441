"""Learning curves and sample size: AUC by number of training subjects, and power to detect an AUC difference."""

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

# Two-sided significance level of the tests, dimensionless.
_SIGNIFICANCE_LEVEL = 0.05
# Power for which the number of subjects is computed; 0.8 is usual in clinical trials.
TARGET_POWER = 0.8
# Keys of `QUESTIONS` for which the power is computed.
_POWER_QUESTIONS = ("do features predict better than measured JSW?", "do features add to measured JSW?")
_POWER_COLUMNS = [
    *(
        "question",
        "grades",
        "predictor_set",
        "reference_set",
        "difference",
        "subjects",
        "splits",
        "standard_error",
        "power",
    ),
    *("required_subjects", "required_subjects_low", "required_subjects_high"),
]


def compute_learning_curves(splits: pd.DataFrame) -> pd.DataFrame:
    """Average the AUC of each predictor set per training fraction and compute the gain from the next smaller fraction.

    Parameters
    ----------
    splits : DataFrame
        Table from `learn.incremental_value.evaluate_predictor_sets` with several training fractions.

    Returns
    -------
    DataFrame
        Columns of `summarise_predictor_sets`, and gain, gain_low, gain_high: AUC minus the AUC at the next smaller
        fraction on the same test subjects, with an interval; NaN for the smallest fraction. The variance correction
        uses the number of training subjects of the smaller fraction. Fractions are in ascending order.
    """
    table = summarise_predictor_sets(splits).sort_values(
        ["grades", "predictor_set", "training_fraction"], kind="stable"
    )
    table = table.drop_duplicates(["grades", "predictor_set", "training_subjects"], keep="last")
    rows = []
    for (grades, predictor_set), part in table.groupby(["grades", "predictor_set"], sort=False):
        of = splits[(splits["grades"] == grades) & (splits["predictor_set"] == predictor_set)]
        before = None
        for row in part.to_dict("records"):
            here = of[of["training_fraction"] == row["training_fraction"]].set_index("repeat")
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
    """Compute the power of the test in `confidence_intervals.estimate_mean` to detect an AUC difference.

    The significance level is 5 %, two-sided.

    Parameters
    ----------
    error : float
        Standard error of the mean over the splits, from `compute_standard_error`.
    difference : float
        True AUC difference.
    splits : int
        Number of splits.

    Returns
    -------
    float
        Power, 0 to 1.
    """
    return _noncentral_t_power(abs(difference) / error, splits - 1)


def subjects_needed(error: float, difference: float, splits: int, subjects: int) -> float:
    """Compute the number of subjects needed to detect an AUC difference with a power of 0.8.

    The variance of the difference is assumed to be proportional to 1 / subjects.

    Parameters
    ----------
    error : float
        Standard error of the mean over the splits in this cohort.
    difference : float
        True AUC difference.
    splits : int
        Number of splits.
    subjects : int
        Number of subjects in this cohort.

    Returns
    -------
    float
        Required number of subjects.
    """
    shift = brentq(lambda errors: _noncentral_t_power(errors, splits - 1) - TARGET_POWER, 0.1, 100.0)
    return subjects * float(shift * error / abs(difference)) ** 2


def _noncentral_t_power(noncentrality: float, degrees_of_freedom: int) -> float:
    """Compute the power of a two-sided t test; `noncentrality` is the difference divided by its standard error."""
    beyond = float(t_distribution.ppf(1 - _SIGNIFICANCE_LEVEL / 2, degrees_of_freedom))
    # Above five standard errors, a result with the wrong sign has a probability below 1e-8 and scipy may return NaN.
    wrong = float(nct.cdf(-beyond, degrees_of_freedom, noncentrality)) if noncentrality < 5 else 0.0
    return float(nct.sf(beyond, degrees_of_freedom, noncentrality)) + wrong


def variance_interval_factors(splits: int) -> tuple[float, float]:
    """Compute the factors that convert a variance over splits into the limits of its 95 % interval (chi-square).

    The factors are exact for normally distributed values with equal correlations between splits.

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
    """Tabulate the power in this cohort and the number of subjects needed for a power of 0.8.

    Parameters
    ----------
    splits : DataFrame
        Table from `learn.incremental_value.evaluate_predictor_sets`, trained on all training subjects.
    subjects : Series
        Number of subjects of each pair of grades, indexed by the label of the pair.
    difference : float
        AUC difference to be detected.

    Returns
    -------
    DataFrame
        One row per question and pair of grades. Rows whose differences do not vary between splits, or for which the
        reference AUC plus `difference` is above 1, are omitted.
        Columns: question, grades, predictor_set, reference_set, difference, subjects, splits, standard_error (standard
        error of the mean difference), power, required_subjects, required_subjects_low, required_subjects_high (subjects
        of both grades for a power of 0.8).
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
            required = subjects_needed(error, difference, count, int(subjects[grades]))
            low, high = (required * factor for factor in variance_interval_factors(count))
            label = {
                "question": question,
                "grades": grades,
                "predictor_set": one,
                "reference_set": other,
                "difference": difference,
            }
            label |= {"subjects": int(subjects[grades]), "splits": count, "standard_error": error}
            values = {"power": compute_power(error, difference, count), "required_subjects": required}
            rows.append({**label, **values, "required_subjects_low": low, "required_subjects_high": high})
    return pd.DataFrame(rows, columns=_POWER_COLUMNS)


def compute_power_curve(row: pd.Series, subjects: Array) -> Array:
    """Compute the power curve of one comparison for other numbers of subjects.

    Parameters
    ----------
    row : Series
        Row of the table from `tabulate_power`.
    subjects : (n,) float array, counts
        Numbers of subjects, summed over the two grades.

    Returns
    -------
    (n,) float array
        Power for each number of subjects, 0 to 1.
    """
    errors = row["standard_error"] * np.sqrt(row["subjects"] / subjects)
    return np.array([compute_power(error, row["difference"], int(row["splits"])) for error in errors])
