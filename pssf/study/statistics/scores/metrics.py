"""Metrics of predictions; a metric that is undefined on a test set is NaN."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata
from scipy.stats import t as t_distribution
from sklearn.metrics import balanced_accuracy_score, f1_score, roc_curve

from ....core.checks import Array

# Percentiles of a 95 % interval.
INTERVAL_PERCENTILES = (2.5, 97.5)
# Number of points of a mean ROC curve.
_ROC_POINTS = 401
# Metric name in tables -> label in reports.
METRICS = {"auc": "AUC", "balanced_accuracy": "Balanced accuracy", "macro_f1": "Macro F1"}


def score_predictions(truth: NDArray[np.int64], probability: Array) -> dict[str, float]:
    """Compute AUC, balanced accuracy and macro F1.

    For two classes, the AUC is computed for class 1. For more classes, it is the mean of the one-vs-rest AUCs.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class index of each row.
    probability : (rows, classes) float array, probabilities
        Predicted probability of each class.

    Returns
    -------
    dict of str to float
        Value of each metric in `METRICS`; all values are NaN if a class has no row.
    """
    classes, predicted = probability.shape[1], probability.argmax(axis=1)
    if len(np.unique(truth)) < classes:
        return dict.fromkeys(METRICS, float("nan"))
    ones = range(classes) if classes > 2 else (1,)
    return {
        "auc": float(np.mean([auc(truth == k, probability[:, k]) for k in ones])),
        "balanced_accuracy": float(balanced_accuracy_score(truth, predicted)),
        "macro_f1": float(f1_score(truth, predicted, average="macro")),
    }


def auc(positive: NDArray[np.bool_], value: Array) -> float:
    """Compute the area under the ROC curve by ranks (Hanley and McNeil 1982).

    The AUC is the fraction of positive-negative row pairs in which the positive row has the larger value. A pair with
    equal values counts as one half.

    Parameters
    ----------
    positive : (rows,) bool array
        True for positive rows.
    value : (rows,) float array, any unit
        Predicted value, expected to be larger for positive rows.

    Returns
    -------
    float
        AUC; NaN without positive or without negative rows.
    """
    ones = int(positive.sum())
    pairs = ones * (len(positive) - ones)
    if not pairs:
        return float("nan")
    # sklearn's roc_auc_score is not used: it takes 27 times as long and differs by rounding (2.2e-16).
    return float((rankdata(value)[positive].sum() - ones * (ones + 1) / 2) / pairs)


def auc_with_interval(positive: NDArray[np.bool_], value: Array) -> dict[str, float]:
    """Compute the AUC and its 95 % interval from the numbers of rows (Hanley and McNeil 1982).

    Parameters
    ----------
    positive : (rows,) bool array
        True for positive rows; at least one row must be positive and one negative.
    value : (rows,) float array, any unit
        Predicted value, expected to be larger for positive rows.

    Returns
    -------
    dict of str to float
        AUC (auc) and limits of its 95 % interval (low, high).
    """
    area, ones, zeros = auc(positive, value), int(positive.sum()), int((~positive).sum())
    both, two = area / (2 - area), 2 * area**2 / (1 + area)
    variance = area * (1 - area) + (ones - 1) * (both - area**2) + (zeros - 1) * (two - area**2)
    half = 1.96 * float(np.sqrt(max(variance, 0.0) / (ones * zeros)))
    return {"auc": area, "low": max(0.0, area - half), "high": min(1.0, area + half)}


def mean_roc(truth: NDArray[np.int64], value: Array, split: NDArray[np.int64]) -> tuple[Array, Array]:
    """Average the ROC curves of all splits: mean sensitivity at each false positive rate (Fawcett 2006).

    The area under the mean curve is the mean AUC. A ROC curve of the pooled predictions would mix thresholds of
    different models.

    Parameters
    ----------
    truth : (rows,) int64 array
        True class of each row, 0 or 1.
    value : (rows,) float array, any unit
        Predicted value, expected to be larger for class 1.
    split : (rows,) int64 array
        Index of the split in which the row was a test row.

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

    A row with weight 2 is counted twice, and a row with weight 0 is omitted.

    Parameters
    ----------
    truth : (rows,) int64 array
        Class index of each row.
    probability : (rows, classes) float array, probabilities
        Predicted probability of each class.
    weight : (rows, samples) float array, counts
        Weight of each row in each sample. Whole numbers make the sums exact in any order of addition.

    Returns
    -------
    dict of str to (samples,) float array
        Values of each metric; NaN for all metrics if a class has no weight.
    """
    # sklearn.metrics is not used: with one call per sample, it takes 600 times as long (1000 samples of 120 rows).
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
    """Compute Cohen's kappa of true and predicted class with quadratic weights (Cohen 1968).

    The classes are ordered; a two-class error has four times the weight of a one-class error.

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
        Kappa of each sample; NaN if all true and predicted classes are one single class.
    """
    # sklearn's cohen_kappa_score gives identical results, but one call per sample takes 10,000 times as long.
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
    """Compute the AUC of many weighted samples; a pair of rows has the product of its row weights as weight.

    Parameters
    ----------
    positive : (rows,) bool array
        True for positive rows.
    value : (rows,) float array, any unit
        Predicted value, expected to be larger for positive rows.
    weight : (rows, samples) float array, counts
        Weight of each row in each sample; each sample needs positive and negative rows with nonzero weight.

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
    """Count the rows for each pair of true and predicted (most probable) class.

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
    # sklearn's confusion_matrix is not used because it raises an error for an arm without rows.
    counts = np.zeros((probability.shape[1], probability.shape[1]), dtype=np.int64)
    np.add.at(counts, (truth, probability.argmax(axis=1)), 1)
    return counts


def percentile_interval(values: Array) -> tuple[float, float]:
    """Compute the 2.5th and 97.5th percentiles of the finite values.

    Parameters
    ----------
    values : (replicates,) float array, any unit
        Values of the bootstrap samples.

    Returns
    -------
    tuple of float
        2.5th and 97.5th percentiles; NaN without a finite value.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    low, high = np.percentile(known, INTERVAL_PERCENTILES)
    return float(low), float(high)


def mean_with_interval(values: Array) -> tuple[float, float, float]:
    """Compute the mean of independent values and its 95 % interval from the t distribution.

    Parameters
    ----------
    values : (n,) float array, any unit
        Independent, finite values.

    Returns
    -------
    tuple of float
        Mean, lower limit and upper limit. The limits are NaN for fewer than two values; the mean is NaN for no value.
    """
    nothing = float("nan")
    if len(values) < 2:
        return (float(values[0]) if len(values) else nothing), nothing, nothing
    mean, quantile = float(values.mean()), t_distribution.ppf(INTERVAL_PERCENTILES[1] / 100, len(values) - 1)
    half = float(values.std(ddof=1) / np.sqrt(len(values)) * quantile)
    return mean, mean - half, mean + half
