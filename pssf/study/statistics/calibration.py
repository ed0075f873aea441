"""Whether a probability means what it says; within protocol, grade 0 against 2."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from ...core.checks import Array
from ..predictions import ARM, truth_and_probability
from ..tasks import least_grades
from .fitting import fit_quietly
from .metrics import confusion

_BINS = 10
_CLIP = 1e-6  # a forest may be certain, and its logit infinite


def calibration(predictions: pd.DataFrame) -> pd.DataFrame:
    """model, selection, predictions, slope, intercept, brier, log_odds; test predictions of all splits pooled.

    slope, intercept  of logistic regression of the grade on the logit of the probability (Cox 1958): 1 and 0 where it
                      means what it says; NaN where a line separates the grades, which has no finite slope
    brier             mean squared error of the probability
    log_odds          of grade 2 in the test predictions: the models are fitted with equally weighted grades, which by
                      itself moves the intercept by this much
    """
    rows = []
    for labels, truth, probability in _arms(predictions):
        slope, intercept = _line(truth, probability)
        positive = float(truth.mean())
        odds = float(np.log(positive / (1 - positive))) if 0 < positive < 1 else float("nan")
        brier = float(((probability - truth) ** 2).mean())
        line = {"slope": slope, "intercept": intercept, "brier": brier, "log_odds": odds}
        rows.append({**labels, "predictions": len(truth), **line})
    columns = ["model", "selection", "predictions", "slope", "intercept", "brier", "log_odds"]
    return pd.DataFrame(rows, columns=columns)


def reliability_curve(predictions: pd.DataFrame) -> pd.DataFrame:
    """model, selection, low, high, predictions, mean_probability, observed_share: ten bins, without empty ones."""
    rows = []
    for labels, truth, probability in _arms(predictions):
        place = np.minimum((probability * _BINS).astype(int), _BINS - 1)
        for index in sorted(set(place)):
            inside = place == index
            means = {"mean_probability": probability[inside].mean(), "observed_share": truth[inside].mean()}
            bounds = {"low": index / _BINS, "high": (index + 1) / _BINS, "predictions": int(inside.sum())}
            rows.append({**labels, **bounds, **means})
    columns = ["model", "selection", "low", "high", "predictions", "mean_probability", "observed_share"]
    return pd.DataFrame(rows, columns=columns)


def confusions(predictions: pd.DataFrame) -> pd.DataFrame:
    """ARM, true_grade, predicted_grade, count: summed over the splits, so a knee is counted in each that tests
    it. A class of several grades is called by the least.
    """
    rows = []
    for arm, part in predictions.groupby(ARM, sort=False):
        truth, probability = truth_and_probability(part)
        grades = least_grades(str(arm[0]))
        for (true, called), count in np.ndenumerate(confusion(truth, probability)):
            label = {"true_grade": grades[true], "predicted_grade": grades[called], "count": int(count)}
            rows.append(dict(zip(ARM, arm, strict=True)) | label)
    return pd.DataFrame(rows)


def _arms(predictions: pd.DataFrame) -> list[tuple[dict[str, Any], NDArray[np.int64], Array]]:
    part = predictions[(predictions["task"] == "0 vs 2") & (predictions["scenario"] == "within")]
    part = part[part["model"] != "chance"]  # which says the same of all in a split
    arms = []
    for (model, selection), rows in part.groupby(["model", "selection"], sort=False):
        truth, probability = truth_and_probability(rows)
        arms.append(({"model": model, "selection": selection}, truth, probability[:, 1]))
    return arms


def _line(truth: NDArray[np.int64], probability: Array) -> tuple[float, float]:
    """Slope and intercept, or NaN where they are not finite or not defined."""
    logit = np.log(np.clip(probability, _CLIP, 1 - _CLIP) / np.clip(1 - probability, _CLIP, 1 - _CLIP))
    one, zero = logit[truth == 1], logit[truth == 0]
    if not len(one) or not len(zero) or np.ptp(logit) < 1e-9 or one.min() >= zero.max() or zero.min() >= one.max():
        return float("nan"), float("nan")
    model = fit_quietly(LogisticRegression(C=np.inf, solver="newton-cholesky", tol=1e-10), logit[:, None], truth)
    return float(model.coef_[0, 0]), float(model.intercept_[0])
