"""Three classifiers, and what they must do better than, each tuned on the validation subjects over a small grid."""

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

from ...core.checks import Array, require_choice
from ..statistics.fitting import fit_quietly

# Of each model of `settings.MODELS`, and of chance.
_GRIDS: dict[str, list[dict[str, Any]]] = {
    "lr": [{"C": c} for c in (0.01, 0.1, 1.0, 10.0)],
    "rf": [{"min_samples_leaf": leaf} for leaf in (4, 1)],
    "xgb": [{"max_depth": depth} for depth in (2, 4)],
    "chance": [{}],
}


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A model and all that was learnt before it.

    pipeline    from all features to probabilities of the classes
    parameters  what the validation subjects chose
    importance  feature -> share of the model's importance; the shares sum to 1; empty for chance
    """

    pipeline: Pipeline
    parameters: dict[str, Any]
    importance: dict[str, float]


def tune(
    prepared: Pipeline,
    model: str,
    training: tuple[pd.DataFrame, NDArray[np.int64]],
    validation: tuple[pd.DataFrame, NDArray[np.int64]],
    *,
    seed: int,
) -> Fitted:
    """The model whose parameters do best on the validation radiographs; it has learnt from the training ones alone.

    Best is the least logarithmic loss: with a few validation knees the AUC has too few values to choose by.

    model     one of `settings.MODELS`, or "chance": the shares of the classes in training
    prepared  fitted `selection.preparation`, of the same training radiographs
    training, validation   features (rows, features), class index (rows,); without validation rows the first, most
                           cautious, parameters are taken
    """
    require_choice("model", model, _GRIDS)
    X, y = prepared.transform(training[0]).to_numpy(), training[1]
    X_check = prepared.transform(validation[0]).to_numpy() if len(validation[1]) else None
    weight = _weight(model, y)
    best: tuple[float, Any, dict[str, Any]] | None = None
    for parameters in _GRIDS[model]:
        candidate = fit_quietly(_unfitted(model, parameters, seed), X, y, weight)
        loss = 0.0 if X_check is None else _loss(candidate, X_check, validation[1], np.unique(y))
        if best is None or loss < best[0]:
            best = loss, candidate, parameters
    assert best is not None
    return _fitted(prepared, best[1], best[2])


def refit(
    prepared: Pipeline,
    model: str,
    parameters: dict[str, Any],
    rows: tuple[pd.DataFrame, NDArray[np.int64]],
    *,
    seed: int,
) -> Fitted:
    """The model of known parameters, which has learnt from all the rows given.

    prepared    fitted `selection.preparation`, of the same rows
    parameters  of `tune`
    rows        features (rows, features), class index (rows,)
    """
    X, y = prepared.transform(rows[0]).to_numpy(), rows[1]
    return _fitted(prepared, fit_quietly(_unfitted(model, parameters, seed), X, y, _weight(model, y)), parameters)


def _fitted(prepared: Pipeline, model: Any, parameters: dict[str, Any]) -> Fitted:
    shares = _importance(model)
    return Fitted(
        pipeline=Pipeline([*prepared.steps, ("values", _Values()), ("model", model)]),
        parameters=parameters,
        importance=dict(zip(prepared.named_steps["select"].kept_, shares.tolist(), strict=False)),
    )


def _weight(model: str, y: NDArray[np.int64]) -> Array:
    # Chance is the shares of the classes as they are, which equal weights would hide.
    return np.ones(len(y)) if model == "chance" else compute_sample_weight("balanced", y)


def _loss(model: Any, X: Array, y: NDArray[np.int64], classes: NDArray[np.int64]) -> float:
    return log_loss(y, model.predict_proba(X), sample_weight=compute_sample_weight("balanced", y), labels=classes)


class _Values(TransformerMixin, BaseEstimator):
    """Step of a pipeline: a table's values without their names, as the models were fitted."""

    def fit(self, X: pd.DataFrame, y: Any = None) -> "_Values":
        return self

    def transform(self, X: pd.DataFrame) -> Array:
        return X.to_numpy()

    def __sklearn_is_fitted__(self) -> bool:
        return True


def _unfitted(model: str, parameters: dict[str, Any], seed: int) -> Any:
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


def _importance(model: Any) -> Array:
    """(features,) shares: |coefficients| of standardised features, impurity (forest) or gain (boosting)."""
    if isinstance(model, DummyClassifier):
        return np.zeros(0)
    raw = np.abs(model.coef_).mean(axis=0) if hasattr(model, "coef_") else model.feature_importances_
    raw = np.nan_to_num(np.asarray(raw, dtype=np.float64))
    return raw / raw.sum() if raw.sum() > 0 else np.full(len(raw), 1 / len(raw))
