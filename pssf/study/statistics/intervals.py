"""95 per cent intervals of the scores, and of their differences, by a bootstrap of subjects.

A replicate draws subjects with replacement within their grade, each with all its knees, radiographs and the splits that
tested it; it scores every split with these weights and takes the mean over the splits. The models stay as they were
fitted, so an interval holds the chance of who is tested, and not that of who was trained on.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...core.checks import Array
from ..predictions import ARM, NONE, TASKS, least_grades, truth_and_probability
from .metrics import METRICS, percentiles, weighted_scores
from .subjects import draws, worst_grades

_STREAM = 2**31  # keys below it are those of the splits
# Comparison -> a scenario, and the one that is taken from it.
COMPARISONS = {
    "cross minus within": ("cross", "within"),
    "multi minus within": ("multi", "within"),
    "multi minus cross": ("multi", "cross"),
    "stable features minus all": ("cross_stable", "cross"),
    "harmonised minus plain": ("cross_harmonised", "cross"),
}
MINUS_JSW = "model minus JSW (true)"
_LABELS = ["comparison", "task", "scenario", "tested_on", "model", "selection", "metric"]


@dataclass(frozen=True, eq=False)
class Replicates:
    """The mean score over the splits of every arm in every replicate.

    arms    values of ARM
    scores  metric -> (arms, 1 + replicates); first the cohort as it is
    """

    arms: list[tuple[str, ...]]
    scores: dict[str, Array]


def resample(predictions: pd.DataFrame, *, replicates: int, seed: int) -> Replicates:
    """Score every arm on bootstrap samples of the subjects; see the module.

    predictions  ARM, repeat, subject, truth, p0, p1 and so on
    """
    weights = subject_weights(predictions, replicates=replicates, seed=seed)
    values = weights.to_numpy()
    arms: list[tuple[str, ...]] = []
    scores: dict[str, list[Array]] = {metric: [] for metric in METRICS}
    for arm, part in predictions.groupby(ARM, sort=False):
        of_splits = []
        for _, split in part.groupby("repeat", sort=False):
            rows = weights.index.get_indexer(split["subject"])
            of_splits.append(weighted_scores(*truth_and_probability(split), values[rows]))
        arms.append(tuple(arm))
        for metric in METRICS:
            scores[metric].append(mean_of_splits(np.array([one[metric] for one in of_splits])))
    return Replicates(arms, {metric: np.array(rows) for metric, rows in scores.items()})


def subject_weights(predictions: pd.DataFrame, *, replicates: int, seed: int) -> pd.DataFrame:
    """(subjects, 1 + replicates) how often each subject is drawn; ones in the first column.

    Drawn within the subject's grade, the highest of its knees, so that the share of each grade stays.
    """
    grades = predictions["truth"].astype(int).copy()
    for task in TASKS:
        rows = predictions["task"] == task
        grades[rows] = np.array(least_grades(task))[grades[rows]]
    worst = worst_grades(predictions["subject"], grades)
    return pd.DataFrame(draws(worst, replicates=replicates, seed=seed, stream=_STREAM), index=worst.index)


def intervals(replicates: Replicates) -> pd.DataFrame:
    """ARM, and the 2.5th and 97.5th percentile of each metric over the replicates: <metric>_low, <metric>_high."""
    rows = []
    for index, arm in enumerate(replicates.arms):
        row: dict[str, object] = dict(zip(ARM, arm, strict=True))
        for metric in METRICS:
            low, high = percentiles(replicates.scores[metric][index, 1:])
            row |= {f"{metric}_low": low, f"{metric}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def differences(replicates: Replicates) -> pd.DataFrame:
    """Paired differences of arms: in every replicate both are scored on the same subjects.

    returns  comparison, task, scenario, tested_on, model, selection, metric, difference, low, high, p, p_holm. p is
             two-sided: twice the share of replicates on the farther side of 0, at least 2 / (replicates + 1); p_holm
             is corrected within a comparison, task and metric (Holm 1979)
    """
    rows = []
    for comparison, this, other in _pairs(replicates.arms):
        label = dict(zip(ARM, replicates.arms[this], strict=True))
        for metric, scores in replicates.scores.items():
            difference = scores[this] - scores[other]
            low, high = percentiles(difference[1:])
            estimate = {"difference": difference[0], "low": low, "high": high, "p": p_value(difference[1:])}
            rows.append({"comparison": comparison, **label, "metric": metric, **estimate})
    table = pd.DataFrame(rows, columns=[*_LABELS, "difference", "low", "high", "p"])
    table["p_holm"] = np.nan
    for _, part in table.dropna(subset="p").groupby(["comparison", "task", "metric"], sort=False):
        table.loc[part.index, "p_holm"] = holm(part["p"].to_numpy())
    return table


def p_value(differences: Array) -> float:
    """Two-sided p of a difference (Davison & Hinkley 1997, with one added to both counts).

    differences  (replicates,) of any unit; those that are not finite are left out
    returns      NaN where none is
    """
    known = differences[np.isfinite(differences)]
    if not len(known):
        return float("nan")
    farther = min((known <= 0).sum(), (known >= 0).sum())
    return float(min(1.0, 2 * (farther + 1) / (len(known) + 1)))


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


def mean_of_splits(splits: Array) -> Array:
    """(samples,) mean over the splits that have a score; NaN where none has.

    splits  (splits, samples)  scores, dimensionless
    """
    known = np.isfinite(splits)
    with np.errstate(invalid="ignore"):
        return np.where(known, splits, 0.0).sum(axis=0) / known.sum(axis=0)
