"""Fitting of scikit-learn models without warnings about a solver change."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning

from ....core.checks import Array


def fit_without_solver_warnings(model: Any, X: Array, y: NDArray[np.int64], weight: Array | None = None) -> Any:
    """Fit a scikit-learn model and suppress the warning that L-BFGS replaces the Newton solver.

    Parameters
    ----------
    model : estimator
        Unfitted model.
    X : (rows, features) float array, any unit
        Predictors.
    y : (rows,) int64 array
        Class index of each row.
    weight : (rows,) float array, dimensionless, optional
        Weight of each row; None: all rows have equal weight.

    Returns
    -------
    estimator
        The fitted model.
    """
    with warnings.catch_warnings():
        # If the line search of the Newton solver ends early, scikit-learn continues with L-BFGS and gives a warning.
        warnings.filterwarnings("ignore", "Line search of Newton solver", ConvergenceWarning)
        return model.fit(X, y, sample_weight=weight)
