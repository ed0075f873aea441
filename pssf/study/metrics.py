"""How good predictions are. A measure that a test part cannot give is NaN, not a guess."""

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import balanced_accuracy_score, confusion_matrix, f1_score, roc_auc_score

from ..checks import Array

METRICS = {"auc": "AUC", "balanced_accuracy": "Balanced accuracy", "macro_f1": "Macro F1"}


def score(truth: NDArray[np.int64], probability: Array) -> dict[str, float]:
    """AUC (of class 1, or the mean of each class against the rest), balanced accuracy, macro F1.

    truth        (rows,) class index
    probability  (rows, classes)
    returns      NaN for all three where a class has no row
    """
    classes = np.arange(probability.shape[1])
    if set(np.unique(truth)) != set(classes):
        return dict.fromkeys(METRICS, float("nan"))
    called = probability.argmax(axis=1)
    # One class against the rest, each by itself: sklearn's own average wants rows that sum to 1 to the last bit.
    one_against_rest = [roc_auc_score(truth == k, probability[:, k]) for k in (classes if len(classes) > 2 else [1])]
    return {
        "auc": float(np.mean(one_against_rest)),
        "balanced_accuracy": float(balanced_accuracy_score(truth, called)),
        "macro_f1": float(f1_score(truth, called, average="macro", labels=classes, zero_division=0.0)),
    }


def confusion(truth: NDArray[np.int64], probability: Array) -> NDArray[np.int64]:
    """(classes, classes) counts: rows are the true class, columns the most probable."""
    return confusion_matrix(truth, probability.argmax(axis=1), labels=np.arange(probability.shape[1]))
