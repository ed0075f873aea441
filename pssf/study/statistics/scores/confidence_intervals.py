"""95 % intervals of scores and of their differences, from the variation over the splits.

Each split trains and tests anew, so the scores of the splits include the variation of the training and test sets. The
splits overlap, and the mean of their scores varies more than that of independent splits. Nadeau and Bengio 2003
(Machine Learning 52, 239) give the variance of the mean of R splits as s^2 (1/R + tested/trained subjects). The
quantile is that of a t distribution with R - 1 degrees of freedom.

Scores end at 1, so their intervals are computed on the logit scale (Pepe 2003). If a small cohort happens to be well
separated, its splits hardly vary, and an interval on the plain scale would lie above the true score.
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

# Comparisons of scenarios: the first minus the second.
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
        Lower end of the 95 % interval.
    high : float
        Upper end of the 95 % interval.
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
        Part of each subject: repeat, subject, part.

    Returns
    -------
    float
        Ratio, dimensionless.
    """
    counts = subjects.groupby(["repeat", "part"]).size().unstack("part")
    return float((counts["test"] / counts["training"]).mean())


def estimate_mean(splits: Array, ratio: float, lower_limit: float = -1.0, upper_limit: float = 1.0) -> Estimate:
    """Estimate the mean of a measure over the splits, with its interval; see the module.

    Parameters
    ----------
    splits : (splits,) float array, dimensionless
        Value of each split; values that are not finite are left out.
    ratio : float
        Ratio of test to training subjects, of `compute_test_train_ratio`.
    lower_limit : float, default -1
        Smallest possible value of the measure.
    upper_limit : float, default 1
        Largest possible value of the measure.

    Returns
    -------
    Estimate
        Estimate. A single value has no interval and no p (NaN). If all values are equal, the interval has no width; p
        is then 1 for the value 0 and undefined otherwise, because nothing shows how far the values could have differed.
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
        Two or more finite values.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    float
        Standard error.
    """
    return float(splits.std(ddof=1) * np.sqrt(1 / len(splits) + ratio))


def estimate_proportion(splits: Array, ratio: float) -> Estimate:
    """Estimate the mean of a measure between 0 and 1.

    The interval is symmetric on the logit scale (delta method).

    Parameters
    ----------
    splits : (splits,) float array, dimensionless
        Value of each split; values that are not finite are left out.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    Estimate
        Estimate, as of `estimate_mean`.
    """
    of_splits = estimate_mean(splits, ratio, -np.inf, np.inf)
    if not of_splits.high > of_splits.low:
        return of_splits
    # Values that vary between 0 and 1 have a mean strictly inside, so the logit and its derivative are finite.
    middle, half = (
        logit(of_splits.value),
        (of_splits.high - of_splits.low) / 2 / (of_splits.value * (1 - of_splits.value)),
    )
    return replace(of_splits, low=float(expit(middle - half)), high=float(expit(middle + half)))


def compute_metric_intervals(splits: pd.DataFrame, ratio: float) -> dict[str, float]:
    """Compute the interval of every metric.

    Parameters
    ----------
    splits : DataFrame
        One row per split, with the columns `METRICS`.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    dict of str to float
        <metric>_low and <metric>_high of every metric.
    """
    row = dict[str, float]()
    for metric in METRICS:
        of_splits = estimate_proportion(splits[metric].to_numpy(np.float64), ratio)
        row |= {f"{metric}_low": of_splits.low, f"{metric}_high": of_splits.high}
    return row


def compute_arm_intervals(splits: pd.DataFrame, ratio: float) -> pd.DataFrame:
    """Compute the interval of every metric for every arm.

    Parameters
    ----------
    splits : DataFrame
        Scores of `split_scores.score_splits`.
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
    """Compare pairs of arms; in every split both arms are trained and tested on the same subjects.

    Parameters
    ----------
    splits : DataFrame
        Scores of `split_scores.score_splits`.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    DataFrame
        One row per pair of arms and metric: comparison, task, scenario, tested_on, model, selection, metric,
        difference, low, high, p, p_holm, `TEST_COUNT_COLUMNS`. p is two-sided. It has no lower limit that the
        correction for more tests could raise above 0.05. p_holm is corrected within a comparison, task and metric (Holm
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
        One row per test.
    family : list of str
        Columns that identify a family.

    Returns
    -------
    Series
        Corrected p of each row; NaN if there is no p.
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
        Corrected p-values, in the same order.
    """
    # The function of statsmodels is not used, because each call runs the garbage collector, which takes 0.3 s.
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return corrected


def _find_arm_pairs(arms: list[tuple[str, ...]]) -> Iterator[tuple[str, int, int]]:
    """Yield each comparison with the indices of its two arms.

    The arms of a pair have the same task, model and selection, or are a model and the JSW baseline.
    """
    known = {(task, scenario, on, model, chosen): i for i, (task, scenario, _, on, model, chosen) in enumerate(arms)}
    reference = next((on for _, scenario, _, on, _, _ in arms if scenario == "within"), "")
    for comparison, (first, second) in COMPARISONS.items():
        for index, (task, scenario, _, tested_on, model, selection) in enumerate(arms):
            if scenario != first or selection == NO_SELECTION:
                continue
            if first == "multi" and second == "within" and tested_on != reference:
                continue  # The test radiographs of other protocols are not those of the reference.
            partner = known.get((task, second, reference if second == "within" else tested_on, model, selection))
            if partner is not None:
                yield comparison, index, partner
    for index, (task, scenario, _, tested_on, _, selection) in enumerate(arms):
        partner = known.get((task, scenario, tested_on, "jsw", NO_SELECTION))
        if selection != NO_SELECTION and partner is not None:
            yield MODEL_MINUS_JSW, index, partner
