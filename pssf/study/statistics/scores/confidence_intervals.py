"""95 % intervals of scores and of score differences, from the variation between splits.

Models are trained and tested anew on each split, so the scores include the variation of the training and test sets. The
splits overlap, so the mean score has a larger variance than the mean over independent splits. Nadeau and Bengio 2003
(Machine Learning 52, 239) give the variance of the mean of R splits as s^2 (1/R + n_test / n_train). Here s^2 is the
variance between splits, and n_test and n_train are the numbers of test and training subjects. The interval uses the
quantile of a t distribution with R - 1 degrees of freedom.

Scores are at most 1, so their intervals are computed on the logit scale (Pepe 2003). Scores near 1 hardly vary between
the splits of a small cohort, and a symmetric interval could be entirely above the true score.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.special import expit, logit
from scipy.stats import t as t_distribution

from ....core.checks import Array
from ...predictions import ARM_COLUMNS, NO_SELECTION
from .metrics import METRICS
from .tested_subjects import TEST_COUNT_COLUMNS

# Comparison -> two scenarios; the score of the second is subtracted from the score of the first.
COMPARISONS = {
    "cross minus within": ("cross", "within"),
    "multi minus within": ("multi", "within"),
    "multi minus cross": ("multi", "cross"),
    "mixed minus cross": ("mixed", "cross"),
    "multi minus mixed": ("multi", "mixed"),
    "stable features minus all": ("cross_stable", "cross"),
    "harmonised minus plain": ("cross_harmonised", "cross"),
}
MODEL_MINUS_JSW = "model minus JSW (true)"
_LABEL_COLUMNS = ["comparison", "task", "scenario", "tested_on", "model", "selection", "metric"]
_CONFIDENCE_LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """Mean over the splits with its 95 % interval.

    Attributes
    ----------
    value : float
        Mean over the splits.
    low : float
        Lower limit of the 95 % interval.
    high : float
        Upper limit of the 95 % interval.
    p : float
        Two-sided p-value of the hypothesis that the mean is 0.
    """

    value: float
    low: float
    high: float
    p: float


def compute_test_train_ratio(subjects: pd.DataFrame) -> float:
    """Compute the ratio of test subjects to training subjects, averaged over the splits.

    Parameters
    ----------
    subjects : DataFrame
        Columns repeat, subject and part (training, validation or test).

    Returns
    -------
    float
        Mean ratio of test to training subjects, dimensionless.
    """
    counts = subjects.groupby(["repeat", "part"]).size().unstack("part")
    return float((counts["test"] / counts["training"]).mean())


def estimate_mean(splits: Array, ratio: float, lower_limit: float = -1.0, upper_limit: float = 1.0) -> Estimate:
    """Estimate the mean of a measure over the splits and its 95 % interval (method: see the module docstring).

    Parameters
    ----------
    splits : (splits,) float array, dimensionless
        Value on each split; non-finite values are ignored.
    ratio : float
        Ratio of test to training subjects, from `compute_test_train_ratio`.
    lower_limit : float, default -1
        Smallest possible value of the measure.
    upper_limit : float, default 1
        Largest possible value of the measure.

    Returns
    -------
    Estimate
        Mean, interval and p. For a single value, interval and p are NaN. If all values are equal, the interval has no
        width, and p is 1 for the value 0 and NaN otherwise, because the variance cannot be estimated.
    """
    known = splits[np.isfinite(splits)]
    nothing = float("nan")
    if len(known) < 2:
        return Estimate(float(known[0]) if len(known) else nothing, nothing, nothing, nothing)
    value, free = float(known.mean()), len(known) - 1
    if np.ptp(known) < 1e-12:
        return Estimate(value, value, value, 1.0 if abs(value) < 1e-12 else nothing)
    error = compute_standard_error(known, ratio)
    half = error * float(t_distribution.ppf((1 + _CONFIDENCE_LEVEL) / 2, free))
    p = 2 * float(t_distribution.sf(abs(value) / error, free))
    return Estimate(value, max(lower_limit, value - half), min(upper_limit, value + half), p)


def compute_standard_error(splits: Array, ratio: float) -> float:
    """Compute the standard error of the mean over overlapping splits (Nadeau and Bengio 2003).

    Parameters
    ----------
    splits : (splits,) float array, dimensionless
        Value on each split; at least two values, all finite.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    float
        Standard error of the mean.
    """
    return float(splits.std(ddof=1) * np.sqrt(1 / len(splits) + ratio))


def estimate_proportion(splits: Array, ratio: float) -> Estimate:
    """Estimate the mean of a measure between 0 and 1.

    The interval is symmetric on the logit scale (delta method).

    Parameters
    ----------
    splits : (splits,) float array, dimensionless
        Value on each split; non-finite values are ignored.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    Estimate
        Mean, interval and p; see `estimate_mean`.
    """
    of_splits = estimate_mean(splits, ratio, -np.inf, np.inf)
    if not of_splits.high > of_splits.low:
        return of_splits
    # Values between 0 and 1 that are not all equal have a mean strictly between 0 and 1, so its logit is finite.
    middle, half = (
        logit(of_splits.value),
        (of_splits.high - of_splits.low) / 2 / (of_splits.value * (1 - of_splits.value)),
    )
    return replace(of_splits, low=float(expit(middle - half)), high=float(expit(middle + half)))


def compute_metric_intervals(splits: pd.DataFrame, ratio: float) -> dict[str, float]:
    """Compute the 95 % interval of every metric for one arm.

    Parameters
    ----------
    splits : DataFrame
        One row per split, with one column per metric in `METRICS`.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    dict of str to float
        Limits of the interval of every metric: <metric>_low and <metric>_high.
    """
    row = dict[str, float]()
    for metric in METRICS:
        of_splits = estimate_proportion(splits[metric].to_numpy(np.float64), ratio)
        row |= {f"{metric}_low": of_splits.low, f"{metric}_high": of_splits.high}
    return row


def compute_arm_intervals(splits: pd.DataFrame, ratio: float) -> pd.DataFrame:
    """Compute the 95 % interval of every metric for every arm.

    Parameters
    ----------
    splits : DataFrame
        Table from `split_scores.score_splits`.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    DataFrame
        One row per arm: `ARM_COLUMNS`, <metric>_low and <metric>_high.
    """
    return pd.DataFrame(
        [
            dict(zip(ARM_COLUMNS, arm, strict=True)) | compute_metric_intervals(part, ratio)
            for arm, part in splits.groupby(ARM_COLUMNS, sort=False)
        ]
    )


def compare_arms(splits: pd.DataFrame, ratio: float) -> pd.DataFrame:
    """Compare the metrics of pairs of arms that use the same training and test subjects in each split.

    Parameters
    ----------
    splits : DataFrame
        Table from `split_scores.score_splits`.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    DataFrame
        One row per pair of arms and metric: comparison, task, scenario, tested_on, model, selection, metric,
        difference, low, high, p, p_holm, `TEST_COUNT_COLUMNS`. p is two-sided and, unlike a
        permutation p-value, can be arbitrarily small. p_holm is p corrected within a comparison, task and metric (Holm
        1979).
    """
    arms = {tuple(arm): part.set_index("repeat") for arm, part in splits.groupby(ARM_COLUMNS, sort=False)}
    names, rows = list(arms), []
    for comparison, this, other in _find_arm_pairs(names):
        label, one, two = dict(zip(ARM_COLUMNS, names[this], strict=True)), arms[names[this]], arms[names[other]]
        counts = {name: int(np.minimum(one[name], two[name]).median()) for name in TEST_COUNT_COLUMNS}
        for metric in METRICS:
            of_splits = estimate_mean((one[metric] - two[metric]).to_numpy(np.float64), ratio)
            values = {"difference": of_splits.value, "low": of_splits.low, "high": of_splits.high, "p": of_splits.p}
            rows.append({"comparison": comparison, **label, "metric": metric, **values, **counts})
    table = pd.DataFrame(rows, columns=[*_LABEL_COLUMNS, "difference", "low", "high", "p", *TEST_COUNT_COLUMNS])
    table.insert(
        len(table.columns) - len(TEST_COUNT_COLUMNS),
        "p_holm",
        apply_holm_within(table, ["comparison", "task", "metric"]),
    )
    return table


def apply_holm_within(table: pd.DataFrame, family: list[str]) -> pd.Series:
    """Apply Holm's correction to the column ``p`` within each family of tests.

    Parameters
    ----------
    table : DataFrame
        One row per test, with the uncorrected p-value in the column ``p``.
    family : list of str
        Columns whose values identify a family of tests.

    Returns
    -------
    Series
        Corrected p-value of each row; NaN if ``p`` is NaN.
    """
    corrected = pd.Series(np.nan, index=table.index, dtype=np.float64)
    for _, part in table.dropna(subset="p").groupby(family, sort=False):
        corrected[part.index] = apply_holm(part["p"].to_numpy())
    return corrected


def apply_holm(p: Array) -> Array:
    """Correct p-values for the number of tests (Holm 1979).

    Parameters
    ----------
    p : (tests,) float array, probabilities
        Uncorrected p-values.

    Returns
    -------
    (tests,) float array
        Corrected p-values, in the order of `p`.
    """
    # The statsmodels function is not used, because each call runs the garbage collector, which takes 0.3 s.
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return corrected


def _find_arm_pairs(arms: list[tuple[str, ...]]) -> Iterator[tuple[str, int, int]]:
    """Yield the name of each comparison and the indices of its two arms.

    The arms of a pair have the same task, model and selection, or are a model and the JSW baseline.
    """
    known = {(task, scenario, on, model, chosen): i for i, (task, scenario, _, on, model, chosen) in enumerate(arms)}
    reference = next((on for _, scenario, _, on, _, _ in arms if scenario == "within"), "")
    for comparison, (first, second) in COMPARISONS.items():
        for index, (task, scenario, _, tested_on, model, selection) in enumerate(arms):
            if scenario != first or selection == NO_SELECTION:
                continue
            if first == "multi" and second == "within" and tested_on != reference:
                continue  # In the within scenario, models are tested only on the reference protocol.
            partner = known.get((task, second, reference if second == "within" else tested_on, model, selection))
            if partner is not None:
                yield comparison, index, partner
    for index, (task, scenario, _, tested_on, _, selection) in enumerate(arms):
        partner = known.get((task, scenario, tested_on, "jsw", NO_SELECTION))
        if selection != NO_SELECTION and partner is not None:
            yield MODEL_MINUS_JSW, index, partner
