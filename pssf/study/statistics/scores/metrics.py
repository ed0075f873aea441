"""Metrics of predictions; a metric that a test part does not define is NaN."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata
from scipy.stats import t as t_distribution
from sklearn.metrics import roc_curve

from ....core.checks import Array

# Percentiles of a 95 % interval.
INTERVAL_PERCENTILES = (2.5, 97.5)
# Number of points of a mean ROC curve.
_ROC_POINTS = 401
# Metrics by column name, with their labels.
METRICS = {"auc": "AUC", "balanced_accuracy": "Balanced accuracy", "macro_f1": "Macro F1"}


def score_predictions(truth: NDArray[np.int64], probability: Array) -> dict[str, float]:
    """Compute AUC, balanced accuracy and macro F1.

    With two classes the AUC is that of class 1; with more it is the mean of each class against the rest.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class index of each row.
    probability : (rows, classes) float array, probabilities
        Predicted probability of each class.

    Returns
    -------
    dict of str to float
        Value of each of `METRICS`; NaN for all if a class has no row.
    """
    counts = confusion_matrix(truth, probability)
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
    """Compute the area under the ROC curve by ranks (Hanley and McNeil 1982).

    It is the fraction of pairs of a positive and a negative row in which the positive row has the larger value. Ties
    count one half.

    Parameters
    ----------
    positive : (rows,) bool array
        True for positive rows.
    value : (rows,) float array, any unit
        Value that is larger for positive rows.

    Returns
    -------
    float
        AUC; NaN without a pair.
    """
    ones = int(positive.sum())
    pairs = ones * (len(positive) - ones)
    if not pairs:
        return float("nan")
    return float((rankdata(value)[positive].sum() - ones * (ones + 1) / 2) / pairs)


def auc_with_interval(positive: NDArray[np.bool_], value: Array) -> dict[str, float]:
    """Compute the AUC and its 95 % interval from the numbers of rows (Hanley and McNeil 1982).

    Parameters
    ----------
    positive : (rows,) bool array
        True for positive rows; both kinds must occur.
    value : (rows,) float array, any unit
        Value that is larger for positive rows.

    Returns
    -------
    dict of str to float
        auc, low and high.
    """
    area, ones, zeros = auc(positive, value), int(positive.sum()), int((~positive).sum())
    both, two = area / (2 - area), 2 * area**2 / (1 + area)
    variance = area * (1 - area) + (ones - 1) * (both - area**2) + (zeros - 1) * (two - area**2)
    half = 1.96 * float(np.sqrt(max(variance, 0.0) / (ones * zeros)))
    return {"auc": area, "low": max(0.0, area - half), "high": min(1.0, area + half)}


def mean_roc(truth: NDArray[np.int64], value: Array, split: NDArray[np.int64]) -> tuple[Array, Array]:
    """Average the ROC curves of the splits vertically (Fawcett 2006).

    The area under the mean curve is the mean AUC. A pooled curve would mix the thresholds of different models.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class 0 or 1 of each row.
    value : (rows,) float array, any unit
        Value that is larger for class 1.
    split : (rows,) int64 array
        Number of the split that tested the row.

    Returns
    -------
    false_positive_rate : (points,) float array
        1 - specificity, from 0 to 1; empty if no split has both classes.
    sensitivity : (points,) float array
        Mean sensitivity, from 0 to 1; empty if no split has both classes.
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
    """Compute the metrics of `score_predictions` for many weighted samples of the same rows at once.

    A weight of 2 counts a row twice, and a weight of 0 leaves it out.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class index of each row.
    probability : (rows, classes) float array, probabilities
        Predicted probability of each class.
    weight : (rows, samples) float array, counts
        Weight of each row in each sample. Counts make every sum exact, whatever the order of addition.

    Returns
    -------
    dict of str to (samples,) float array
        Values of each metric; NaN for all metrics if a class has no weight.
    """
    classes = probability.shape[1]
    counts = _weighted_confusion(truth, probability, weight)
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
    """Compute Cohen's kappa of true and most probable class with quadratic weights (Cohen 1968).

    The classes are ordered: an error of two classes counts four times as much as an error of one.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class index of each row.
    probability : (rows, classes) float array, probabilities
        Predicted probability of each class.
    weight : (rows, samples) float array, counts
        Weight of each row in each sample.

    Returns
    -------
    (samples,) float array
        Kappa; NaN if all true and predicted classes are the same one.
    """
    counts = _weighted_confusion(truth, probability, weight)
    places = np.arange(len(counts))
    off = (places[:, None] - places) ** 2
    by_chance = counts.sum(axis=1)[:, None] * counts.sum(axis=0)[None] / counts.sum(axis=(0, 1))
    seen, expected = (np.einsum("kl,kls->s", off, table) for table in (counts, by_chance))
    return np.asarray(1.0 - np.divide(seen, expected, out=np.full_like(expected, np.nan), where=expected > 0))


def _weighted_confusion(truth: NDArray[np.int64], probability: Array, weight: Array) -> Array:
    """Compute the weighted confusion matrix (classes, classes, samples); see `weighted_kappa` for the arguments."""
    classes = probability.shape[1]
    cell = np.zeros((classes * classes, len(truth)))
    cell[truth * classes + probability.argmax(axis=1), np.arange(len(truth))] = 1.0
    return np.asarray((cell @ weight).reshape(classes, classes, -1))


def weighted_auc(positive: NDArray[np.bool_], value: Array, weight: Array) -> Array:
    """Compute the AUC of many weighted samples; each pair counts as often as both of its rows.

    Parameters
    ----------
    positive : (rows,) bool array
        True for positive rows.
    value : (rows,) float array, any unit
        Value that is larger for positive rows.
    weight : (rows, samples) float array, counts
        Weight of each row in each sample; both kinds must have weight in each sample.

    Returns
    -------
    (samples,) float array
        AUC of each sample.
    """
    above, below = value[positive][:, None], value[~positive][None, :]
    in_order = (above > below) + 0.5 * (above == below)
    of_positive, of_negative = weight[positive], weight[~positive]
    wins = np.einsum("ns,ns->s", in_order.T @ of_positive, of_negative)
    return wins / (of_positive.sum(axis=0) * of_negative.sum(axis=0))


def confusion_matrix(truth: NDArray[np.int64], probability: Array) -> NDArray[np.int64]:
    """Count true classes against most probable classes.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class index of each row.
    probability : (rows, classes) float array, probabilities
        Predicted probability of each class.

    Returns
    -------
    (classes, classes) int64 array
        Counts: rows are true classes, columns are predicted classes.
    """
    counts = np.zeros((probability.shape[1], probability.shape[1]), dtype=np.int64)
    np.add.at(counts, (truth, probability.argmax(axis=1)), 1)
    return counts


def percentile_interval(values: Array) -> tuple[float, float]:
    """Compute the 2.5th and 97.5th percentile of the finite values.

    Parameters
    ----------
    values : (replicates,) float array, any unit
        Values of the bootstrap samples.

    Returns
    -------
    tuple of float
        Both percentiles; NaN without a finite value.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    low, high = np.percentile(known, INTERVAL_PERCENTILES)
    return float(low), float(high)


def mean_with_interval(values: Array) -> tuple[float, float, float]:
    """Compute the mean of independent values and its 95 % interval by the t distribution.

    Parameters
    ----------
    values : (n,) float array, any unit
        Finite values.

    Returns
    -------
    tuple of float
        Mean, lower end and upper end; NaN where there are too few values.
    """
    nothing = float("nan")
    if len(values) < 2:
        return (float(values[0]) if len(values) else nothing), nothing, nothing
    mean, quantile = float(values.mean()), t_distribution.ppf(INTERVAL_PERCENTILES[1] / 100, len(values) - 1)
    half = float(values.std(ddof=1) / np.sqrt(len(values)) * quantile)
    return mean, mean - half, mean + half
