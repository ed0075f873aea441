"""Classifiers and the chance baseline, each tuned on the validation subjects over a small grid."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.dummy import DummyClassifier
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.pipeline import Pipeline
from sklearn.utils.class_weight import compute_sample_weight
from xgboost import XGBClassifier

from ....core.checks import Array, require_choice
from ...statistics.scores.quiet_fit import fit_without_solver_warnings

# Hyperparameter grid of each classifier in `study_settings.MODELS` and of the chance baseline.
_GRIDS: dict[str, list[dict[str, Any]]] = {
    "lr": [{"C": c} for c in (0.01, 0.1, 1.0, 10.0)],
    "rf": [{"min_samples_leaf": leaf} for leaf in (4, 1)],
    "xgb": [{"max_depth": depth} for depth in (2, 4)],
    "chance": [{}],
}


@dataclass(frozen=True, kw_only=True)
class FittedModel:
    """Fitted classifier with its fitted preprocessing.

    Attributes
    ----------
    pipeline : Pipeline
        Pipeline that predicts class probabilities from all features.
    parameters : dict of str to Any
        Hyperparameters selected with the validation subjects.
    importance : dict of str to float
        Importance of each feature, with sum 1; empty for the chance baseline.
    """

    pipeline: Pipeline
    parameters: dict[str, Any]
    importance: dict[str, float]


def tune_classifier(
    prepared: Pipeline,
    model: str,
    training: tuple[pd.DataFrame, NDArray[np.int64]],
    validation: tuple[pd.DataFrame, NDArray[np.int64]],
    *,
    seed: int,
) -> FittedModel:
    """Fit a classifier to the training rows, and select its hyperparameters with the validation rows.

    The criterion is the lowest log loss, because the AUC has few distinct values with few validation knees.

    Parameters
    ----------
    prepared : Pipeline
        Pipeline from `build_feature_pipeline`, fitted to the same training rows.
    model : str
        Classifier from `study_settings.MODELS`, or "chance", which predicts the class frequencies of the training rows.
    training : tuple of DataFrame and (rows,) int64 array
        Features and class index of the training rows.
    validation : tuple of DataFrame and (rows,) int64 array
        Features and class index of the validation rows. Without validation rows, the first hyperparameters in the grid,
        which have the strongest regularisation, are used.
    seed : int
        Seed of the classifier.

    Returns
    -------
    FittedModel
        Classifier fitted to the training rows only.

    Raises
    ------
    InputError
        The classifier is unknown.
    """
    require_choice("model", model, _GRIDS)
    X, y = prepared.transform(training[0]).to_numpy(), training[1]
    X_check = prepared.transform(validation[0]).to_numpy() if len(validation[1]) else None
    weight = _compute_sample_weights(model, y)
    best: tuple[float, Any, dict[str, Any]] | None = None
    for parameters in _GRIDS[model]:
        candidate = fit_without_solver_warnings(_make_classifier(model, parameters, seed), X, y, weight)
        loss = 0.0 if X_check is None else _compute_loss(candidate, X_check, validation[1], np.unique(y))
        if best is None or loss < best[0]:
            best = loss, candidate, parameters
    assert best is not None
    return _assemble_model(prepared, best[1], best[2])


def fit_with_parameters(
    prepared: Pipeline,
    model: str,
    parameters: dict[str, Any],
    rows: tuple[pd.DataFrame, NDArray[np.int64]],
    *,
    seed: int,
) -> FittedModel:
    """Fit a classifier with specified hyperparameters to all rows.

    Parameters
    ----------
    prepared : Pipeline
        Pipeline from `build_feature_pipeline`, fitted to the same rows.
    model : str
        Classifier from `study_settings.MODELS`, or "chance".
    parameters : dict of str to Any
        Hyperparameters, as selected by `tune_classifier`.
    rows : tuple of DataFrame and (rows,) int64 array
        Features and class index of the rows.
    seed : int
        Seed of the classifier.

    Returns
    -------
    FittedModel
        Classifier fitted to all rows.
    """
    X, y = prepared.transform(rows[0]).to_numpy(), rows[1]
    return _assemble_model(
        prepared,
        fit_without_solver_warnings(_make_classifier(model, parameters, seed), X, y, _compute_sample_weights(model, y)),
        parameters,
    )


def _assemble_model(prepared: Pipeline, model: Any, parameters: dict[str, Any]) -> FittedModel:
    """Combine preprocessing and classifier in one pipeline."""
    importance = _compute_importance(model)
    return FittedModel(
        pipeline=Pipeline([*prepared.steps, ("values", _TableToArray()), ("model", model)]),
        parameters=parameters,
        importance=dict(zip(prepared.named_steps["select"].kept_, importance.tolist(), strict=False)),
    )


def _compute_sample_weights(model: str, y: NDArray[np.int64]) -> Array:
    """Compute the sample weights (rows,); all classes have equal weight, except in the chance baseline."""
    # The chance baseline predicts the class frequencies; equal class weights would make all predictions equal.
    return np.ones(len(y)) if model == "chance" else compute_sample_weight("balanced", y)


def _compute_loss(model: Any, X: Array, y: NDArray[np.int64], classes: NDArray[np.int64]) -> float:
    """Compute the log loss with equal class weights."""
    return log_loss(y, model.predict_proba(X), sample_weight=compute_sample_weight("balanced", y), labels=classes)


class _TableToArray(TransformerMixin, BaseEstimator):
    """Pipeline step that converts a table to an array, because the classifiers are fitted without column names."""

    def fit(self, X: pd.DataFrame, y: Any = None) -> "_TableToArray":
        """Return this transformer unchanged, because it has no parameters to fit."""
        return self

    def transform(self, X: pd.DataFrame) -> Array:
        """Return the values (rows, columns) of a table."""
        return X.to_numpy()

    def __sklearn_is_fitted__(self) -> bool:
        return True


def _make_classifier(model: str, parameters: dict[str, Any], seed: int) -> Any:
    """Make an unfitted classifier with specified hyperparameters."""
    make: dict[str, Callable[[], Any]] = {
        "lr": lambda: LogisticRegression(solver="newton-cholesky", **parameters),
        "rf": lambda: RandomForestClassifier(n_estimators=100, n_jobs=1, random_state=seed, **parameters),
        "xgb": lambda: XGBClassifier(
            n_estimators=60,
            learning_rate=0.1,
            tree_method="hist",
            n_jobs=1,
            random_state=seed,
            verbosity=0,
            **parameters,
        ),
        "chance": DummyClassifier,
    }
    return make[model]()


def _compute_importance(model: Any) -> Array:
    """Compute the importance (features,) of each feature as a fraction of the sum of importances.

    The importance is the absolute coefficient of standardised features, the impurity decrease (forest) or the gain
    (boosting).
    """
    if isinstance(model, DummyClassifier):
        return np.zeros(0)
    raw = np.abs(model.coef_).mean(axis=0) if hasattr(model, "coef_") else model.feature_importances_
    raw = np.nan_to_num(np.asarray(raw, dtype=np.float64))
    return raw / raw.sum() if raw.sum() > 0 else np.full(len(raw), 1 / len(raw))
