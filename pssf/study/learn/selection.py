"""From all features to a few. Everything is learnt in `fit`, which sees training radiographs alone."""

from typing import Any

import numpy as np
import pandas as pd
from feature_engine.selection import MRMR
from numpy.typing import NDArray
from scipy.stats import rankdata
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from ...core.checks import require_choice
from ..predictions import NONE
from ..settings import SELECTIONS
from ..statistics.degenerate import is_degenerate

_INVERSE_STRENGTHS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)


class DropRedundant(TransformerMixin, BaseEstimator):
    """Leaves out features that carry nothing, and those that repeat another one: |Spearman's rho| above `rho`.

    Of features that repeat each other the one stays that repeats the most others, the closest; of equals the first by
    name. So neither the order of the columns nor a family's place in it decides, here or in the steps that follow.
    (feature-engine's DropCorrelatedFeatures keeps the first by order: of features of 50 people 34 instead of 31, 23 of
    them the same.)

    fit  X (rows, features) table; kept_ are the names that stay, by name
    """

    def __init__(self, rho: float = 0.9) -> None:
        self.rho = rho

    def fit(self, X: pd.DataFrame, y: Any = None) -> "DropRedundant":
        # Not by DropConstantFeatures, to which what varies in the last bit, as the mean of a z-score, is no constant.
        names = [name for name in sorted(X.columns) if not is_degenerate(X[name].to_numpy())]
        # Where nothing varies at all, a model still needs a column: it will learn the shares of the classes.
        self.kept_ = self._distinct(X[names]) or [min(X.columns)]
        self.median_ = X[self.kept_].median().fillna(0.0)
        return self

    def _distinct(self, X: pd.DataFrame) -> list[str]:
        if X.shape[1] < 2:
            return list(X.columns)
        # Rounded, so that what repeats equally well is a tie whatever the order of adding.
        rho = np.abs(np.corrcoef(rankdata(X.to_numpy(np.float64), axis=0), rowvar=False)).round(9)
        kept, left = [], np.ones(len(rho), bool)
        while left.any():
            near = (rho > self.rho) & left
            worth = near.sum(axis=1) + (rho * near).sum(axis=1) / (len(rho) + 1)
            best = int(np.where(left, worth.round(9), -1.0).argmax())
            kept.append(best)
            left &= ~near[best]
            left[best] = False
        return [X.columns[index] for index in sorted(kept)]

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        # A feature may be undefined in a radiograph met later, such as the elongation of a mask that is a line.
        # By numpy, for fillna goes column by column and took a third of the time of a prediction.
        values = X[self.kept_].to_numpy(np.float64)
        filled = np.where(np.isnan(values), self.median_.to_numpy(), values)
        return pd.DataFrame(filled, columns=self.kept_, index=X.index)


class SelectL1(TransformerMixin, BaseEstimator):
    """Features to which L1-regularised logistic regression gives a coefficient, at most `most` of the largest.

    The penalty is the strongest of a list that leaves at least three features, or all where there are fewer.

    fit  X (rows, features) table, y (rows,) grade; kept_ are the names that stay
    """

    def __init__(self, most: int = 10, random_state: int = 0) -> None:
        self.most = most
        self.random_state = random_state

    def fit(self, X: pd.DataFrame, y: NDArray[np.int64]) -> "SelectL1":
        enough = min(3, X.shape[1], self.most)
        weight = np.zeros(X.shape[1])
        for strength in _INVERSE_STRENGTHS:
            weight = self._weight(X, y, strength)
            if np.count_nonzero(weight) >= enough:
                break
        best = np.argsort(-weight, kind="stable")[: self.most]
        chosen = [index for index in sorted(best) if weight[index] > 0] or [int(best[0])]
        self.kept_ = [X.columns[index] for index in chosen]
        return self

    def _weight(self, X: pd.DataFrame, y: NDArray[np.int64], strength: float) -> NDArray[np.float64]:
        largest = np.zeros(X.shape[1])
        # One grade against the rest, since liblinear knows only two; saga knows more and is ten times slower.
        for grade in np.unique(y)[1 if len(np.unique(y)) == 2 else 0 :]:
            model = LogisticRegression(
                l1_ratio=1,
                solver="liblinear",
                C=strength,
                class_weight="balanced",
                random_state=self.random_state,
                max_iter=1000,
            )
            coefficients = model.fit(X.to_numpy(), (y == grade).astype(int)).coef_[0]
            largest = np.maximum(largest, np.abs(coefficients))
        return largest

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        return X[self.kept_]


class SelectMRMR(TransformerMixin, BaseEstimator):
    """`most` features of least redundancy and most relevance, by the quotient of F and correlation (Zhao 2019, FCQ).

    fit  X (rows, features) table, y (rows,) grade; kept_ are the names that stay
    """

    def __init__(self, most: int = 10) -> None:
        self.most = most

    def fit(self, X: pd.DataFrame, y: NDArray[np.int64]) -> "SelectMRMR":
        self.kept_ = list(X.columns)
        if X.shape[1] > self.most:
            chooser = MRMR(method="FCQ", max_features=self.most, discrete_features=False)
            chooser.fit(X, pd.Series(y, index=X.index))
            dropped = set(chooser.features_to_drop_)
            self.kept_ = [name for name in X.columns if name not in dropped]
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        return X[self.kept_]


class SelectAll(TransformerMixin, BaseEstimator):
    """Every feature: for the few measurements of a baseline."""

    def fit(self, X: pd.DataFrame, y: Any = None) -> "SelectAll":
        self.kept_ = list(X.columns)
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        return X[self.kept_]


def preparation(selection: str, *, rho: float, most: int, seed: int) -> Pipeline:
    """Leave out what repeats, standardise, select; unfitted. `selection` is one of SELECTIONS, or "none"."""
    require_choice("selection", selection, (*SELECTIONS, NONE))
    choosers = {"l1": SelectL1(most=most, random_state=seed), "mrmr": SelectMRMR(most=most), NONE: SelectAll()}
    scale = StandardScaler().set_output(transform="pandas")
    return Pipeline([("drop", DropRedundant(rho)), ("scale", scale), ("select", choosers[selection])])
