"""Permutation importance of the features of a fitted model."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score
from sklearn.pipeline import Pipeline

from ....core.checks import Array

# Number of shuffles per feature; the importance is the mean over the shuffles.
_SHUFFLES = 5


def compute_permutation_importance(
    pipeline: Pipeline, features: pd.DataFrame, truth: NDArray[np.int64], *, seed: int
) -> dict[str, float]:
    """Compute the mean drop of AUC when a feature is shuffled between the test radiographs (Breiman 2001).

    Each feature that the model uses is shuffled five times, with the same permutations as in scikit-learn's
    `permutation_importance`. All shuffled copies are predicted in one call, because one copy takes a random forest
    nearly as long as all copies together.

    Parameters
    ----------
    pipeline : Pipeline
        Fitted pipeline.
    features : DataFrame
        Features (rows, features) of the test radiographs.
    truth : (rows,) int64 array
        True class of each row, 0 or 1.
    seed : int
        Seed of the shuffles.

    Returns
    -------
    dict of str to float
        AUC drop for each feature of the model; empty if the test radiographs lack a class.
    """
    if len(set(truth)) < 2:
        return {}
    kept = pipeline[:-1].transform(features)
    shuffled = np.repeat(kept[None], 1 + kept.shape[1] * _SHUFFLES, axis=0)  # Copy 0 is unshuffled.
    for turn, order in enumerate(_make_shuffle_orders(len(kept), seed)):
        for column in range(kept.shape[1]):
            shuffled[1 + column * _SHUFFLES + turn, :, column] = kept[order, column]
    values = _compute_decision_values(pipeline[-1], shuffled.reshape(-1, kept.shape[1])).reshape(
        len(shuffled), len(kept)
    )
    whole, *others = (roc_auc_score(truth, value) for value in values)
    falls = (whole - np.reshape(others, (-1, _SHUFFLES))).mean(axis=1)
    return dict(zip(pipeline.named_steps["select"].kept_, falls.tolist(), strict=True))


def _make_shuffle_orders(rows: int, seed: int) -> list[NDArray[np.int64]]:
    """Make the row order of each shuffle, as (rows,) arrays; each shuffle permutes the previous row order."""
    rng = np.random.RandomState(np.random.RandomState(seed % 2**32).randint(2**31))
    places, order, orders = np.arange(rows), np.arange(rows), []
    for _ in range(_SHUFFLES):
        rng.shuffle(places)
        order = order[places]
        orders.append(order)
    return orders


def _compute_decision_values(model: Any, table: Array) -> Array:
    """Compute the decision function, or else the probability of class 1, for each row of a (rows, features) array."""
    if hasattr(model, "decision_function"):
        return np.asarray(model.decision_function(table))
    return np.asarray(model.predict_proba(table)[:, 1])
