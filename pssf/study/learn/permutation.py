"""What a fitted model loses without a feature."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score
from sklearn.pipeline import Pipeline

from ...core.checks import Array

_SHUFFLES = 5


def permuted(pipeline: Pipeline, features: pd.DataFrame, truth: NDArray[np.int64], *, seed: int) -> dict[str, float]:
    """Feature -> by how much the AUC of a test part falls when the feature is shuffled between radiographs.

    Mean of five shuffles (Breiman 2001); of the features that the model was given, the others change nothing. The
    shuffles are those of scikit-learn's `permutation_importance`, which asks the model for one after the other: a
    forest takes nearly as long for one as for all.

    features  (rows, features) of the test part
    truth     (rows,) 0 or 1; without both, nothing is given
    """
    if len(set(truth)) < 2:
        return {}
    kept = pipeline[:-1].transform(features)
    shuffled = np.repeat(kept[None], 1 + kept.shape[1] * _SHUFFLES, axis=0)  # the first stays as it is
    for turn, order in enumerate(_orders(len(kept), seed)):
        for column in range(kept.shape[1]):
            shuffled[1 + column * _SHUFFLES + turn, :, column] = kept[order, column]
    values = _values(pipeline[-1], shuffled.reshape(-1, kept.shape[1])).reshape(len(shuffled), len(kept))
    whole, *others = (roc_auc_score(truth, value) for value in values)
    falls = (whole - np.reshape(others, (-1, _SHUFFLES))).mean(axis=1)
    return dict(zip(pipeline.named_steps["select"].kept_, falls.tolist(), strict=True))


def _orders(rows: int, seed: int) -> list[NDArray[np.int64]]:
    """(rows,) each: the rows in the order of every shuffle, each of which shuffles the one before."""
    rng = np.random.RandomState(np.random.RandomState(seed % 2**32).randint(2**31))
    places, order, orders = np.arange(rows), np.arange(rows), []
    for _ in range(_SHUFFLES):
        rng.shuffle(places)
        order = order[places]
        orders.append(order)
    return orders


def _values(model: Any, table: Array) -> Array:
    """(rows,)  what is larger the likelier class 1 is

    table  (rows, features)
    """
    if hasattr(model, "decision_function"):
        return np.asarray(model.decision_function(table))
    return np.asarray(model.predict_proba(table)[:, 1])
