"""Feature selection: prune redundant features, standardise, and select.

All steps are fitted to training radiographs only.
"""

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

from ....core.checks import require_choice
from ...design.study_settings import SELECTIONS
from ...predictions import NO_SELECTION
from ...statistics.features.degenerate_features import is_degenerate

# Inverse regularisation strengths C of the L1 selection, starting with the strongest regularisation.
_INVERSE_STRENGTHS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)


class DropRedundant(TransformerMixin, BaseEstimator):
    """Transformer that removes degenerate and redundant features.

    Two features are redundant if their absolute Spearman correlation is above `rho`.

    Among redundant features, the feature that is redundant with the most other features is retained. Ties are broken by
    the sum of correlations, then by name. The result is therefore independent of the column order. In contrast,
    DropCorrelatedFeatures of feature-engine retains the first column. For 50 subjects, DropCorrelatedFeatures retains
    34 features and DropRedundant 31; 23 features are retained by both.

    Parameters
    ----------
    rho : float, default 0.9
        Absolute Spearman correlation above which two features are redundant.

    Attributes
    ----------
    kept_ : list of str
        Names of the remaining features, in alphabetical order.
    median_ : Series
        Training median of each remaining feature, which replaces missing values.
    """

    def __init__(self, rho: float = 0.9) -> None:
        self.rho = rho

    def fit(self, X: pd.DataFrame, y: Any = None) -> "DropRedundant":
        """Find the features to retain.

        Parameters
        ----------
        X : DataFrame
            Training features (rows, features).
        y : (rows,) array, optional
            Class indices, which are not used.

        Returns
        -------
        DropRedundant
            Fitted transformer.
        """
        # DropConstantFeatures would retain features that vary only by rounding errors, such as the mean of a z-score.
        names = [name for name in sorted(X.columns) if not is_degenerate(X[name].to_numpy())]
        # A model needs at least one column. If all features are constant, the model predicts the class frequencies.
        self.kept_ = self._select_uncorrelated(X[names]) or [min(X.columns)]
        self.median_ = X[self.kept_].median().fillna(0.0)
        return self

    def _select_uncorrelated(self, X: pd.DataFrame) -> list[str]:
        """Select the names of the features to retain."""
        if X.shape[1] < 2:
            return list(X.columns)
        # Correlations are rounded so that ties do not depend on the order of summation.
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
        """Return the retained features, with missing values replaced by the training median.

        Parameters
        ----------
        X : DataFrame
            Features (rows, features).

        Returns
        -------
        DataFrame
            Columns listed in ``kept_``.
        """
        # A feature that is defined in all training radiographs may be undefined in a test radiograph.
        # numpy is used, because fillna processes each column separately and would take a third of the prediction time.
        values = X[self.kept_].to_numpy(np.float64)
        filled = np.where(np.isnan(values), self.median_.to_numpy(), values)
        return pd.DataFrame(filled, columns=self.kept_, index=X.index)


class SelectL1(TransformerMixin, BaseEstimator):
    """Transformer that selects features with a nonzero coefficient in L1-regularised logistic regression.

    Regularisation is weakened until at least three coefficients are nonzero, or fewer if there are fewer features. At
    most `max_features` features with the largest coefficients are selected.

    Parameters
    ----------
    max_features : int, default 10
        Maximum number of selected features.
    random_state : int, default 0
        Seed of the solver.

    Attributes
    ----------
    kept_ : list of str
        Names of the selected features.
    """

    def __init__(self, max_features: int = 10, random_state: int = 0) -> None:
        self.max_features = max_features
        self.random_state = random_state

    def fit(self, X: pd.DataFrame, y: NDArray[np.int64]) -> "SelectL1":
        """Select features from the training rows.

        Parameters
        ----------
        X : DataFrame
            Training features (rows, features), standardised.
        y : (rows,) int64 array
            Class index of each row.

        Returns
        -------
        SelectL1
            Fitted transformer.
        """
        enough = min(3, X.shape[1], self.max_features)
        weight = np.zeros(X.shape[1])
        for strength in _INVERSE_STRENGTHS:
            weight = self._fit_coefficients(X, y, strength)
            if np.count_nonzero(weight) >= enough:
                break
        best = np.argsort(-weight, kind="stable")[: self.max_features]
        chosen = [index for index in sorted(best) if weight[index] > 0] or [int(best[0])]
        self.kept_ = [X.columns[index] for index in chosen]
        return self

    def _fit_coefficients(self, X: pd.DataFrame, y: NDArray[np.int64], strength: float) -> NDArray[np.float64]:
        """Fit one model per class; return the maximum absolute coefficient of each feature, as a (features,) array."""
        largest = np.zeros(X.shape[1])
        # One-vs-rest models are fitted, because liblinear supports only two classes, and saga is ten times slower.
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
        """Return the selected features.

        Parameters
        ----------
        X : DataFrame
            Features (rows, features).

        Returns
        -------
        DataFrame
            Columns listed in ``kept_``.
        """
        return X[self.kept_]


class SelectMRMR(TransformerMixin, BaseEstimator):
    """Transformer that selects features of maximum relevance and minimum redundancy.

    The criterion is the quotient of F statistic and correlation (FCQ; Zhao 2019).

    Parameters
    ----------
    max_features : int, default 10
        Number of selected features.

    Attributes
    ----------
    kept_ : list of str
        Names of the selected features.
    """

    def __init__(self, max_features: int = 10) -> None:
        self.max_features = max_features

    def fit(self, X: pd.DataFrame, y: NDArray[np.int64]) -> "SelectMRMR":
        """Select features from the training rows.

        Parameters
        ----------
        X : DataFrame
            Training features (rows, features), standardised.
        y : (rows,) int64 array
            Class index of each row.

        Returns
        -------
        SelectMRMR
            Fitted transformer.
        """
        self.kept_ = list(X.columns)
        if X.shape[1] > self.max_features:
            chooser = MRMR(method="FCQ", max_features=self.max_features, discrete_features=False)
            chooser.fit(X, pd.Series(y, index=X.index))
            dropped = set(chooser.features_to_drop_)
            self.kept_ = [name for name in X.columns if name not in dropped]
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """Return the selected features.

        Parameters
        ----------
        X : DataFrame
            Features (rows, features).

        Returns
        -------
        DataFrame
            Columns listed in ``kept_``.
        """
        return X[self.kept_]


class SelectAll(TransformerMixin, BaseEstimator):
    """Transformer that selects every feature, for baselines with few columns.

    Attributes
    ----------
    kept_ : list of str
        Names of all features.
    """

    def fit(self, X: pd.DataFrame, y: Any = None) -> "SelectAll":
        """Store the names of all features.

        Parameters
        ----------
        X : DataFrame
            Training features (rows, features).
        y : (rows,) array, optional
            Class indices, which are not used.

        Returns
        -------
        SelectAll
            Fitted transformer.
        """
        self.kept_ = list(X.columns)
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """Return all features, without selection.

        Parameters
        ----------
        X : DataFrame
            Features (rows, features).

        Returns
        -------
        DataFrame
            Columns listed in ``kept_``.
        """
        return X[self.kept_]


def build_feature_pipeline(selection: str, *, rho: float, max_features: int, seed: int) -> Pipeline:
    """Build an unfitted pipeline that prunes redundant features, standardises features, and selects features.

    Parameters
    ----------
    selection : str
        Feature selection from `SELECTIONS`, or "none".
    rho : float
        Absolute Spearman correlation above which two features are redundant.
    max_features : int
        Maximum number of selected features.
    seed : int
        Seed of the feature selection.

    Returns
    -------
    Pipeline
        Unfitted pipeline with the steps ``drop``, ``scale`` and ``select``.

    Raises
    ------
    InputError
        The selection is unknown.
    """
    require_choice("selection", selection, (*SELECTIONS, NO_SELECTION))
    choosers = {
        "l1": SelectL1(max_features=max_features, random_state=seed),
        "mrmr": SelectMRMR(max_features=max_features),
        NO_SELECTION: SelectAll(),
    }
    scale = StandardScaler().set_output(transform="pandas")
    return Pipeline([("drop", DropRedundant(rho)), ("scale", scale), ("select", choosers[selection])])
