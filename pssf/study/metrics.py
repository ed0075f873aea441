"""How good predictions are. A measure that a test part cannot give is NaN, not a guess."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from ..checks import Array

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

    positive, value   (rows,)
    returns           NaN without a pair (Hanley & McNeil 1982: the area under the ROC curve, by ranks)
    """
    ones = int(positive.sum())
    pairs = ones * (len(positive) - ones)
    if not pairs:
        return float("nan")
    return float((rankdata(value)[positive].sum() - ones * (ones + 1) / 2) / pairs)


def confusion(truth: NDArray[np.int64], probability: Array) -> NDArray[np.int64]:
    """(classes, classes) counts: rows are the true class, columns the most probable."""
    counts = np.zeros((probability.shape[1], probability.shape[1]), dtype=np.int64)
    np.add.at(counts, (truth, probability.argmax(axis=1)), 1)
    return counts
