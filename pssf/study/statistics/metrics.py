"""How good predictions are. A measure that a test part cannot give is NaN, not a guess."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata
from scipy.stats import t as t_distribution
from sklearn.metrics import roc_curve

from ...core.checks import Array

LEVELS = (2.5, 97.5)
_ROC_POINTS = 401
METRICS = {"auc": "AUC", "balanced_accuracy": "Balanced accuracy", "macro_f1": "Macro F1"}


def score(truth: NDArray[np.int64], probability: Array) -> dict[str, float]:
    """AUC (of class 1, or the mean of each class against the rest), balanced accuracy, macro F1.

    truth        (rows,) class index
    probability  (rows, classes)
    returns      NaN for all three where a class has no row
    """
    counts = confusion(truth, probability)
    if not counts.sum(axis=1).all():
        return dict.fromkeys(METRICS, float("nan"))
    ones = range(len(counts)) if len(counts) > 2 else (1,)
    right = counts.diagonal()
    return {
        "auc": float(np.mean([auc(truth == k, probability[:, k]) for k in ones])),
        "balanced_accuracy": float((right / counts.sum(axis=1)).mean()),
        # A class that is never predicted has F1 = 0: 2 right / (true + predicted).
        "macro_f1": float((2 * right / (counts.sum(axis=0) + counts.sum(axis=1))).mean()),
    }


def auc(positive: NDArray[np.bool_], value: Array) -> float:
    """Share of pairs of a positive and a negative row in which the positive has the larger value, ties a half.

    positive, value   (rows,) value of any unit
    returns           NaN without a pair (Hanley & McNeil 1982: the area under the ROC curve, by ranks)
    """
    ones = int(positive.sum())
    pairs = ones * (len(positive) - ones)
    if not pairs:
        return float("nan")
    return float((rankdata(value)[positive].sum() - ones * (ones + 1) / 2) / pairs)


def auc_with_interval(positive: NDArray[np.bool_], value: Array) -> dict[str, float]:
    """auc, low, high: with its 95 per cent interval from the counts of rows (Hanley and McNeil 1982)

    positive, value   (rows,) value of any unit; rows of both kinds
    """
    area, ones, zeros = auc(positive, value), int(positive.sum()), int((~positive).sum())
    both, two = area / (2 - area), 2 * area**2 / (1 + area)
    variance = area * (1 - area) + (ones - 1) * (both - area**2) + (zeros - 1) * (two - area**2)
    half = 1.96 * float(np.sqrt(max(variance, 0.0) / (ones * zeros)))
    return {"auc": area, "low": max(0.0, area - half), "high": min(1.0, area + half)}


def mean_roc(truth: NDArray[np.int64], value: Array, split: NDArray[np.int64]) -> tuple[Array, Array]:
    """1 - specificity and mean sensitivity over the splits at it (Fawcett 2006, vertical averaging).

    The area under it is the mean AUC; a curve of all splits pooled would mix thresholds of different models.

    truth, value, split  (rows,): 0 or 1, what is large for 1 in any unit, and the split that a row was tested in
    returns              (points,) each, from 0, 0 to 1, 1; nothing where no split has both classes
    """
    at = np.linspace(0, 1, _ROC_POINTS)
    curves = []
    for one in np.unique(split):
        rows = split == one
        if len(set(truth[rows])) == 2:
            false, true, _ = roc_curve(truth[rows], value[rows])
            curves.append(np.interp(at, false, true))
    if not curves:
        return np.empty(0), np.empty(0)
    return np.concatenate([[0.0], at]), np.concatenate([[0.0], np.mean(curves, axis=0)])


def weighted_scores(truth: NDArray[np.int64], probability: Array, weight: Array) -> dict[str, Array]:
    """`score` of many weighted samples of the same rows at once: a weight of 2 counts a row twice, of 0 not at all.

    truth        (rows,) class index
    probability  (rows, classes)
    weight       (rows, samples) counts, so that every sum is exact and no order of adding shows
    returns      metric -> (samples,); NaN for all three where a class has no weight
    """
    classes = probability.shape[1]
    counts = _weighted_counts(truth, probability, weight)
    true, called, right = counts.sum(axis=1), counts.sum(axis=0), np.einsum("kks->ks", counts)
    ones = range(classes) if classes > 2 else (1,)
    with np.errstate(invalid="ignore", divide="ignore"):
        scores = {
            "auc": np.mean([weighted_auc(truth == k, probability[:, k], weight) for k in ones], axis=0),
            "balanced_accuracy": (right / true).mean(axis=0),
            "macro_f1": (2 * right / (true + called)).mean(axis=0),
        }
    lacking = ~(true > 0).all(axis=0)
    return {metric: np.where(lacking, np.nan, values) for metric, values in scores.items()}


def weighted_kappa(truth: NDArray[np.int64], probability: Array, weight: Array) -> Array:
    """(samples,) Cohen's kappa of true and most probable class, with quadratic weights (Cohen 1968).

    Classes are in an order: being two off counts four times as much as being one off.

    truth        (rows,) class index
    probability  (rows, classes)
    weight       (rows, samples) counts
    returns      NaN where truth and calls are all of one and the same class
    """
    counts = _weighted_counts(truth, probability, weight)
    places = np.arange(len(counts))
    off = (places[:, None] - places) ** 2
    by_chance = counts.sum(axis=1)[:, None] * counts.sum(axis=0)[None] / counts.sum(axis=(0, 1))
    seen, expected = (np.einsum("kl,kls->s", off, table) for table in (counts, by_chance))
    return np.asarray(1.0 - np.divide(seen, expected, out=np.full_like(expected, np.nan), where=expected > 0))


def _weighted_counts(truth: NDArray[np.int64], probability: Array, weight: Array) -> Array:
    """(classes, classes, samples) `confusion` with weights; arguments as `weighted_kappa` has them"""
    classes = probability.shape[1]
    cell = np.zeros((classes * classes, len(truth)))
    cell[truth * classes + probability.argmax(axis=1), np.arange(len(truth))] = 1.0
    return np.asarray((cell @ weight).reshape(classes, classes, -1))


def weighted_auc(positive: NDArray[np.bool_], value: Array, weight: Array) -> Array:
    """(samples,) `auc` with weights: pairs in order over all pairs, each pair counted as often as both its rows.

    positive, value  (rows,) value of any unit
    weight           (rows, samples) counts, some of either kind in each sample
    """
    above, below = value[positive][:, None], value[~positive][None, :]
    in_order = (above > below) + 0.5 * (above == below)
    of_positive, of_negative = weight[positive], weight[~positive]
    wins = np.einsum("ns,ns->s", in_order.T @ of_positive, of_negative)
    return wins / (of_positive.sum(axis=0) * of_negative.sum(axis=0))


def confusion(truth: NDArray[np.int64], probability: Array) -> NDArray[np.int64]:
    """(classes, classes) counts: rows are the true class, columns the most probable.

    truth        (rows,) class index
    probability  (rows, classes)
    """
    counts = np.zeros((probability.shape[1], probability.shape[1]), dtype=np.int64)
    np.add.at(counts, (truth, probability.argmax(axis=1)), 1)
    return counts


def percentiles(values: Array) -> tuple[float, float]:
    """The 2.5th and 97.5th percentile of those that are finite; NaN without any.

    values  (replicates,) of any unit
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    low, high = np.percentile(known, LEVELS)
    return float(low), float(high)


def mean_interval(values: Array) -> tuple[float, float, float]:
    """Mean of independent values and its 95 per cent interval by t; NaN for what too few of them leave open.

    values  (n,) of any unit, finite
    """
    nothing = float("nan")
    if len(values) < 2:
        return (float(values[0]) if len(values) else nothing), nothing, nothing
    mean, quantile = float(values.mean()), t_distribution.ppf(LEVELS[1] / 100, len(values) - 1)
    half = float(values.std(ddof=1) / np.sqrt(len(values)) * quantile)
    return mean, mean - half, mean + half
