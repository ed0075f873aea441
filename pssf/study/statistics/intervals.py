"""95 per cent intervals of the scores, and of their differences, from how the splits vary.

A split trains anew and tests others, so the splits' scores include the variation of the training set and of the test
set; but their parts overlap, and their mean varies more than that of independent splits. Nadeau and Bengio 2003
(Machine Learning 52, 239) put the variance of the mean of R splits at s^2 (1/R + tested/trained subjects); the quantile
is of t with R - 1 degrees of freedom. Scores, which end at 1, have their interval on the logit scale (Pepe 2003):
where a small cohort happens to be told apart well its splits hardly vary, and a plain one would lie above the truth.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.special import expit, logit
from scipy.stats import t as t_distribution

from ...core.checks import Array
from ..predictions import ARM, NONE
from .metrics import METRICS
from .tested import TESTED

# Comparison -> a scenario, and the one that is taken from it.
COMPARISONS = {
    "cross minus within": ("cross", "within"),
    "multi minus within": ("multi", "within"),
    "multi minus cross": ("multi", "cross"),
    "mixed minus cross": ("mixed", "cross"),
    "multi minus mixed": ("multi", "mixed"),
    "stable features minus all": ("cross_stable", "cross"),
    "harmonised minus plain": ("cross_harmonised", "cross"),
}
MINUS_JSW = "model minus JSW (true)"
_LABELS = ["comparison", "task", "scenario", "tested_on", "model", "selection", "metric"]
_LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """Mean over the splits, its 95 per cent interval, and the two-sided p of its being 0."""

    value: float
    low: float
    high: float
    p: float


def share_tested(subjects: pd.DataFrame) -> float:
    """Subjects that a split tests over those that it trains on; the mean of the splits.

    subjects  repeat, subject, part
    """
    counts = subjects.groupby(["repeat", "part"]).size().unstack("part")
    return float((counts["test"] / counts["training"]).mean())


def estimate(splits: Array, ratio: float, least: float = -1.0, most: float = 1.0) -> Estimate:
    """Mean of a measure over the splits, with its interval; see the module.

    splits       (splits,) one value of each, dimensionless; those that are not finite are left out
    ratio        of `share_tested`
    least, most  that the measure can be
    returns      no interval and no p of a single value. Where all are the same the interval has no width, and p is 1
                 for 0 and else undefined, since nothing says how far they could have differed
    """
    known = splits[np.isfinite(splits)]
    nothing = float("nan")
    if len(known) < 2:
        return Estimate(float(known[0]) if len(known) else nothing, nothing, nothing, nothing)
    value, free = float(known.mean()), len(known) - 1
    if np.ptp(known) < 1e-12:
        return Estimate(value, value, value, 1.0 if abs(value) < 1e-12 else nothing)
    error = error_of(known, ratio)
    half = error * float(t_distribution.ppf((1 + _LEVEL) / 2, free))
    p = 2 * float(t_distribution.sf(abs(value) / error, free))
    return Estimate(value, max(least, value - half), min(most, value + half), p)


def error_of(splits: Array, ratio: float) -> float:
    """Standard error of the mean over splits that overlap (Nadeau and Bengio 2003).

    splits  (splits,) two finite values or more, dimensionless
    ratio   of `share_tested`
    """
    return float(splits.std(ddof=1) * np.sqrt(1 / len(splits) + ratio))


def estimate_share(splits: Array, ratio: float) -> Estimate:
    """`estimate` of a measure from 0 to 1, with an interval that is symmetric on the logit scale (delta method).

    splits  (splits,) one share of each, dimensionless; those that are not finite are left out
    ratio   of `share_tested`
    """
    of_splits = estimate(splits, ratio, -np.inf, np.inf)
    if not of_splits.high > of_splits.low:
        return of_splits
    # What varies between 0 and 1 has a mean inside, so that both are finite.
    middle, half = (
        logit(of_splits.value),
        (of_splits.high - of_splits.low) / 2 / (of_splits.value * (1 - of_splits.value)),
    )
    return replace(of_splits, low=float(expit(middle - half)), high=float(expit(middle + half)))


def bounds(splits: pd.DataFrame, ratio: float) -> dict[str, float]:
    """<metric>_low and <metric>_high of every metric.

    splits  one row a split, with the METRICS
    """
    row = dict[str, float]()
    for metric in METRICS:
        of_splits = estimate_share(splits[metric].to_numpy(np.float64), ratio)
        row |= {f"{metric}_low": of_splits.low, f"{metric}_high": of_splits.high}
    return row


def intervals(splits: pd.DataFrame, ratio: float) -> pd.DataFrame:
    """ARM, <metric>_low, <metric>_high: one row an arm.

    splits  of `scores.score_splits`
    ratio   of `share_tested`
    """
    return pd.DataFrame(
        [dict(zip(ARM, arm, strict=True)) | bounds(part, ratio) for arm, part in splits.groupby(ARM, sort=False)]
    )


def differences(splits: pd.DataFrame, ratio: float) -> pd.DataFrame:
    """Paired differences of arms: in every split both are trained and tested on the same subjects.

    splits, ratio  as for `intervals`
    returns        comparison, task, scenario, tested_on, model, selection, metric, difference, low, high, p, p_holm,
                   TESTED. p is two-sided, and has no floor that more tests of a family could lift above 0.05;
                   p_holm is corrected within a comparison, task and metric (Holm 1979)
    """
    arms = {tuple(arm): part.set_index("repeat") for arm, part in splits.groupby(ARM, sort=False)}
    names, rows = list(arms), []
    for comparison, this, other in _pairs(names):
        label, one, two = dict(zip(ARM, names[this], strict=True)), arms[names[this]], arms[names[other]]
        counts = {name: int(np.minimum(one[name], two[name]).median()) for name in TESTED}
        for metric in METRICS:
            of_splits = estimate((one[metric] - two[metric]).to_numpy(np.float64), ratio)
            values = {"difference": of_splits.value, "low": of_splits.low, "high": of_splits.high, "p": of_splits.p}
            rows.append({"comparison": comparison, **label, "metric": metric, **values, **counts})
    table = pd.DataFrame(rows, columns=[*_LABELS, "difference", "low", "high", "p", *TESTED])
    table.insert(len(table.columns) - len(TESTED), "p_holm", holm_within(table, ["comparison", "task", "metric"]))
    return table


def holm_within(table: pd.DataFrame, family: list[str]) -> pd.Series:
    """(rows,) `holm` of the column p within each family; NaN where there is no p.

    family  columns that name it
    """
    corrected = pd.Series(np.nan, index=table.index, dtype=np.float64)
    for _, part in table.dropna(subset="p").groupby(family, sort=False):
        corrected[part.index] = holm(part["p"].to_numpy())
    return corrected


def holm(p: Array) -> Array:
    """(tests,) p-values corrected for their number, in the order given (Holm 1979).

    p  (tests,) probabilities
    """
    # statsmodels has it too, and collects the garbage of the whole process at each call: 0.3 s.
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return corrected


def _pairs(arms: list[tuple[str, ...]]) -> Iterator[tuple[str, int, int]]:
    """Comparison, and the indices of its two arms: of one task, model and selection; or a model and the JSW alone."""
    known = {(task, scenario, on, model, chosen): i for i, (task, scenario, _, on, model, chosen) in enumerate(arms)}
    reference = next((on for _, scenario, _, on, _, _ in arms if scenario == "within"), "")
    for comparison, (first, second) in COMPARISONS.items():
        for index, (task, scenario, _, tested_on, model, selection) in enumerate(arms):
            if scenario != first or selection == NONE:
                continue
            if first == "multi" and second == "within" and tested_on != reference:
                continue  # the other test radiographs are not those of the reference
            partner = known.get((task, second, reference if second == "within" else tested_on, model, selection))
            if partner is not None:
                yield comparison, index, partner
    for index, (task, scenario, _, tested_on, _, selection) in enumerate(arms):
        partner = known.get((task, scenario, tested_on, "jsw", NONE))
        if selection != NONE and partner is not None:
            yield MINUS_JSW, index, partner
