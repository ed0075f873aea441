"""Check calibration slope, intercept, Brier score and confusion counts."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit

from pssf.study.statistics.scores.calibration import compute_calibration, compute_calibration_curve, count_confusions


def make_predictions(truth: np.ndarray, p1: np.ndarray) -> pd.DataFrame:
    """Return a table of predictions of one binary task."""
    labels = {"task": "0 vs 2", "scenario": "within", "trained_on": "a", "tested_on": "a", "model": "lr"}
    table = pd.DataFrame({"truth": truth, "p0": 1 - p1, "p1": p1, "subject": np.arange(len(truth)), "repeat": 0})
    return table.assign(**labels, selection="l1")


@pytest.mark.parametrize(("stretch", "shift"), [(1.0, 0.0), (2.0, 0.0), (1.0, 1.0)])
def test_calibration_recovers_the_simulated_slope_and_intercept(stretch, shift):
    rng = np.random.default_rng(0)
    logit = 1.5 * rng.normal(size=20_000)
    truth = (rng.random(20_000) < expit(logit)).astype(int)
    row = compute_calibration(make_predictions(truth, expit(stretch * logit + shift))).iloc[0]
    # The tolerance is four standard errors of logistic regression on 20000 rows, each below 0.025.
    assert row["slope"] == pytest.approx(1 / stretch, abs=0.1)
    assert row["intercept"] == pytest.approx(-shift / stretch, abs=0.1)
    if stretch == 1 and shift == 0:
        p1 = expit(logit)
        assert row["brier"] == pytest.approx((p1 * (1 - p1)).mean(), abs=4 * 0.25 / np.sqrt(20_000))
        curve = compute_calibration_curve(make_predictions(truth, p1))
        spread = 0.5 / np.sqrt(curve["predictions"])
        assert ((curve["mean_probability"] - curve["observed_fraction"]).abs() < 4 * spread).all()
        assert curve["predictions"].sum() == 20_000


@pytest.mark.parametrize("p1", [np.array([0.1, 0.2, 0.8, 0.9]), np.full(4, 0.5), np.array([0.0, 0.0, 1.0, 1.0])])
def test_the_calibration_slope_is_nan_when_it_is_not_finite(p1):
    row = compute_calibration(make_predictions(np.array([0, 0, 1, 1]), p1)).iloc[0]
    assert np.isnan(row["slope"])
    assert row["brier"] == pytest.approx(((p1 - [0, 0, 1, 1]) ** 2).mean())


def test_confusion_counts_include_every_prediction_of_every_split():
    both = [make_predictions(np.array([0, 0, 1]), np.array([0.2, 0.7, 0.9])).assign(repeat=repeat) for repeat in (0, 1)]
    table = count_confusions(pd.concat(both, ignore_index=True)).set_index(["true_grade", "predicted_grade"])["count"]
    assert table.to_dict() == {(0, 0): 2, (0, 2): 2, (2, 0): 0, (2, 2): 2}


def test_bins_of_the_calibration_curve_contain_probabilities_0_and_1():
    curve = compute_calibration_curve(make_predictions(np.array([0, 1, 1]), np.array([0.0, 0.95, 1.0])))
    assert curve[["low", "high", "predictions"]].to_numpy().tolist() == [[0.0, 0.1, 1], [0.9, 1.0, 2]]
