"""Fits of scikit-learn models without warnings about the choice of solver."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning

from ....core.checks import Array


def fit_without_solver_warnings(model: Any, X: Array, y: NDArray[np.int64], weight: Array | None = None) -> Any:
    """Fit a model of scikit-learn and suppress the warning about a fallback of the Newton solver.

    Parameters
    ----------
    model : estimator
        Unfitted model.
    X : (rows, features) float array, any unit
        Predictors.
    y : (rows,) int64 array
        Class index of each row.
    weight : (rows,) float array, dimensionless, optional
        Weight of each row; None weighs all rows equally.

    Returns
    -------
    estimator
        The fitted model.
    """
    with warnings.catch_warnings():
        # If the line search of the Newton solver ends early, scikit-learn continues with L-BFGS and warns of it.
        warnings.filterwarnings("ignore", "Line search of Newton solver", ConvergenceWarning)
        return model.fit(X, y, sample_weight=weight)
