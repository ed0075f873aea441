"""Fits a model of scikit-learn, and lets it find its optimum by whatever solver it takes."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning

from ...core.checks import Array


def fit_quietly(model: Any, X: Array, y: NDArray[np.int64], weight: Array | None = None) -> Any:
    """The model, fitted, without a word about which of its solvers reached the optimum.

    X       (rows, features) each in its own unit
    y       (rows,) class index
    weight  (rows,) dimensionless; None: all alike
    """
    with warnings.catch_warnings():
        # Where Newton's search along a line ends early, the library goes on with L-BFGS by itself, and says so.
        warnings.filterwarnings("ignore", "Line search of Newton solver", ConvergenceWarning)
        return model.fit(X, y, sample_weight=weight)
