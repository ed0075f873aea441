"""Calibration of predicted probabilities for grade 0 vs 2 in the within-protocol scenario."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from ....core.checks import Array
from ...design.classification_tasks import lowest_grades
from ...predictions import ARM_COLUMNS, extract_truth_and_probability
from .metrics import confusion_matrix
from .quiet_fit import fit_without_solver_warnings

# Number of bins of the calibration curve.
_BINS = 10
# Smallest distance of a probability from 0 and 1, dimensionless; clipping keeps the logit finite.
_MIN_PROBABILITY = 1e-6


def compute_calibration(predictions: pd.DataFrame) -> pd.DataFrame:
    """Compute calibration slope, intercept and Brier score from the pooled test predictions of all splits.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all splits.

    Returns
    -------
    DataFrame
        One row per model and selection. predictions: number of predictions. slope, intercept: coefficients of a
        logistic regression of the grade against the logit of the probability (Cox 1958). Slope 1 and intercept 0 mean
        perfect calibration. Both are NaN if a probability threshold separates the grades perfectly, because the slope
        is then infinite. brier: mean squared error of the probability. log_odds: log odds of grade 2 among the test
        knees. Models are fitted with equal class weights, which shifts the intercept by log_odds.
    """
    rows = []
    for labels, truth, probability in _select_arms(predictions):
        slope, intercept = _fit_calibration_line(truth, probability)
        positive = float(truth.mean())
        odds = float(np.log(positive / (1 - positive))) if 0 < positive < 1 else float("nan")
        # sklearn's brier_score_loss is not used, because its result differs by a rounding error (1.1e-16).
        brier = float(((probability - truth) ** 2).mean())
        line = {"slope": slope, "intercept": intercept, "brier": brier, "log_odds": odds}
        rows.append({**labels, "predictions": len(truth), **line})
    columns = ["model", "selection", "predictions", "slope", "intercept", "brier", "log_odds"]
    return pd.DataFrame(rows, columns=columns)


def compute_calibration_curve(predictions: pd.DataFrame) -> pd.DataFrame:
    """Compute the calibration curve in ten probability bins; empty bins are omitted.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all splits.

    Returns
    -------
    DataFrame
        Columns: model, selection, low, high, predictions, mean_probability, observed_fraction.
    """
    rows = []
    for labels, truth, probability in _select_arms(predictions):
        # sklearn's calibration_curve is not used: it returns no counts and assigns a bin edge to the lower bin.
        place = np.minimum((probability * _BINS).astype(int), _BINS - 1)
        for index in sorted(set(place)):
            inside = place == index
            means = {"mean_probability": probability[inside].mean(), "observed_fraction": truth[inside].mean()}
            bounds = {"low": index / _BINS, "high": (index + 1) / _BINS, "predictions": int(inside.sum())}
            rows.append({**labels, **bounds, **means})
    columns = ["model", "selection", "low", "high", "predictions", "mean_probability", "observed_fraction"]
    return pd.DataFrame(rows, columns=columns)


def count_confusions(predictions: pd.DataFrame) -> pd.DataFrame:
    """Count true and predicted classes of every arm (see `ARM_COLUMNS`), summed over the splits.

    A knee is counted in every split in which it is a test knee. A class is labelled with its lowest grade.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all splits.

    Returns
    -------
    DataFrame
        Columns `ARM_COLUMNS`, true_grade, predicted_grade and count.
    """
    rows = []
    for arm, part in predictions.groupby(ARM_COLUMNS, sort=False):
        truth, probability = extract_truth_and_probability(part)
        grades = lowest_grades(str(arm[0]))
        for (true, called), count in np.ndenumerate(confusion_matrix(truth, probability)):
            label = {"true_grade": grades[true], "predicted_grade": grades[called], "count": int(count)}
            rows.append(dict(zip(ARM_COLUMNS, arm, strict=True)) | label)
    return pd.DataFrame(rows)


def _select_arms(predictions: pd.DataFrame) -> list[tuple[dict[str, Any], NDArray[np.int64], Array]]:
    """Select the within-protocol arms for grade 0 vs 2, with true classes and probabilities of grade 2."""
    part = predictions[(predictions["task"] == "0 vs 2") & (predictions["scenario"] == "within")]
    # The chance baseline is excluded because it predicts the same probability for all rows of a split.
    part = part[part["model"] != "chance"]
    arms = []
    for (model, selection), rows in part.groupby(["model", "selection"], sort=False):
        truth, probability = extract_truth_and_probability(rows)
        arms.append(({"model": model, "selection": selection}, truth, probability[:, 1]))
    return arms


def _fit_calibration_line(truth: NDArray[np.int64], probability: Array) -> tuple[float, float]:
    """Fit calibration slope and intercept; both are NaN if the slope is infinite or undefined."""
    logit = np.log(
        np.clip(probability, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY)
        / np.clip(1 - probability, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY)
    )
    one, zero = logit[truth == 1], logit[truth == 0]
    if not len(one) or not len(zero) or np.ptp(logit) < 1e-9 or one.min() >= zero.max() or zero.min() >= one.max():
        return float("nan"), float("nan")
    model = fit_without_solver_warnings(
        LogisticRegression(C=np.inf, solver="newton-cholesky", tol=1e-10), logit[:, None], truth
    )
    return float(model.coef_[0, 0]), float(model.intercept_[0])
