"""Scores of predictions: AUC, balanced accuracy, macro F1, ROC curves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from sklearn.metrics import balanced_accuracy_score, f1_score, roc_auc_score

from pssf.study.statistics.scores import metrics


def test_metrics_of_four_knees_equal_hand_calculated_values():
    # Positives score 0.9 and 0.3, negatives 0.2 and 0.6: 3 of 4 pairs are ordered, and 1 of 2 per class is correct.
    truth, p = np.array([1, 1, 0, 0]), np.array([0.9, 0.3, 0.2, 0.6])
    found = metrics.score_predictions(truth, np.column_stack([1 - p, p]))
    assert found == {"auc": 0.75, "balanced_accuracy": 0.5, "macro_f1": 0.5}
    assert_array_equal(metrics.confusion_matrix(truth, np.column_stack([1 - p, p])), [[1, 1], [1, 1]])


@settings(max_examples=30)
@given(classes=st.integers(2, 3), rows=st.integers(6, 40), seed=st.integers(0, 1000))
def test_metrics_equal_those_of_scikit_learn(classes, rows, seed):
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.arange(rows) % classes)
    probability = rng.dirichlet(np.ones(classes), rows).round(1) + 1e-3
    probability /= probability.sum(axis=1, keepdims=True)
    predicted = probability.argmax(axis=1)
    theirs = {
        "auc": roc_auc_score(truth, probability[:, 1] if classes == 2 else probability, multi_class="ovr"),
        "balanced_accuracy": balanced_accuracy_score(truth, predicted),
        "macro_f1": f1_score(truth, predicted, average="macro"),
    }
    assert metrics.score_predictions(truth, probability) == pytest.approx(theirs, abs=1e-12)


@given(seed=st.integers(0, 10**6), splits=st.integers(1, 5), levels=st.sampled_from([3, 1000]))
@settings(max_examples=30)
def test_area_under_the_mean_roc_curve_is_the_mean_auc_of_the_splits(seed, splits, levels):
    rng = np.random.default_rng(seed)
    split = np.repeat(np.arange(splits), 20)
    truth = np.tile(np.arange(20) % 2, splits)
    # Each split has its own offset, which a pooled ROC curve would mix.
    value = np.round(rng.random(len(truth)) + 0.5 * truth, int(np.log10(levels))) + 3.0 * split
    false, true = metrics.mean_roc(truth, value, split)
    aucs = [metrics.auc(truth[split == one] == 1, value[split == one]) for one in range(splits)]
    # The tolerance is the interpolation error of ROC steps on a grid of 400 points.
    assert abs(np.trapezoid(true, false) - np.mean(aucs)) < 1 / 400
    assert np.all(np.diff(true) >= 0)
    assert (false[0], true[0], false[-1], true[-1]) == (0, 0, 1, 1)


def test_splits_without_both_classes_have_no_roc_curve():
    false, true = metrics.mean_roc(np.ones(4, np.int64), np.arange(4.0), np.arange(4) % 2)
    assert len(false) == len(true) == 0


def test_metrics_are_nan_without_test_subjects_of_a_class():
    assert all(np.isnan(value) for value in metrics.score_predictions(np.zeros(3, int), np.full((3, 2), 0.5)).values())


@pytest.mark.parametrize(("ones", "zeros"), [(5, 60), (60, 5)])
def test_the_interval_of_an_auc_has_the_spread_of_repeated_samples(ones, zeros):
    # The formula is exact for exponential distributions (Hanley and McNeil 1982). A ratio of 4 gives an AUC of 0.8.
    positive = np.arange(ones + zeros) < ones
    values = np.random.default_rng(0).exponential(np.where(positive, 4.0, 1.0), (4000, len(positive)))
    sd = np.std([metrics.auc(positive, row) for row in values])
    # Each positive value is above 80 % of the negative values.
    found = metrics.auc_with_interval(positive, np.where(positive, 0.8 * zeros - 0.5, np.arange(-ones, zeros)))
    assert found["auc"] == pytest.approx(0.8)
    # The standard error of an SD from 4000 samples is 1.1 %; the distribution of the AUC is not normal.
    assert (found["auc"] - found["low"]) / 1.96 == pytest.approx(sd, rel=0.08)
