"""Check confidence intervals and paired differences over the splits."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.special import logit
from statsmodels.stats.multitest import multipletests

from pssf.study.predictions import ARM_COLUMNS
from pssf.study.statistics.scores import confidence_intervals, metrics
from pssf.study.statistics.scores.split_scores import score_splits, summarise_scores


def make_predictions(*, subjects: int = 30, splits: int = 4, shift: float = 1.5, seed: int = 0) -> pd.DataFrame:
    """Return predictions for two knees per subject: `lr` (the best), `rf` and JSW, within and across protocols."""
    rng = np.random.default_rng(seed)
    truth = np.arange(subjects) % 2
    arms = [("within", "reference", "lr", "l1", shift), ("within", "reference", "jsw", "none", shift)]
    arms += [("cross", "low_dose", "lr", "l1", 0.0), ("within", "reference", "rf", "l1", 0.5 * shift)]
    parts = []
    for repeat in range(splits):
        test = np.repeat(rng.permutation(subjects)[: subjects // 2], 2)
        for scenario, tested_on, model, selection, strength in arms:
            value = strength * truth[test] + rng.normal(size=len(test))
            p1 = 1 / (1 + np.exp(-value + strength / 2))
            labels = {"task": "0 vs 2", "scenario": scenario, "trained_on": "reference", "tested_on": tested_on}
            labels |= {"model": model, "selection": selection, "repeat": repeat}
            parts.append(pd.DataFrame({"subject": test, "truth": truth[test], "p0": 1 - p1, "p1": p1}).assign(**labels))
    return pd.concat(parts, ignore_index=True)


@settings(max_examples=30)
@given(classes=st.integers(2, 3), rows=st.integers(4, 25), seed=st.integers(0, 1000))
def test_weighted_scores_equal_scores_of_repeated_rows(classes, rows, seed):
    rng = np.random.default_rng(seed)
    truth = rng.integers(classes, size=rows)
    # Rounding creates equal probabilities, which the AUC must count as ties.
    probability = rng.dirichlet(np.ones(classes), rows).round(1)
    weight = rng.integers(0, 4, (rows, 5)).astype(float)
    found = metrics.weighted_scores(truth, probability, weight)
    for sample in range(5):
        repeated = np.repeat(np.arange(rows), weight[:, sample].astype(int))
        expected = metrics.score_predictions(truth[repeated], probability[repeated])
        for metric, values in found.items():
            assert_allclose(values[sample], expected[metric], rtol=1e-12, err_msg=metric)


def test_the_interval_of_a_mean_follows_nadeau_and_bengio():
    values = np.array([0.8, 0.9, 0.7, np.nan, 0.85])
    found = confidence_intervals.estimate_mean(values, 15 / 70)
    error = np.std([0.8, 0.9, 0.7, 0.85], ddof=1) * np.sqrt(1 / 4 + 15 / 70)
    assert found.value == pytest.approx(0.8125)
    low, high = scipy.stats.t.interval(0.95, 3, 0.8125, error)
    assert_allclose([found.low, found.high], [low, min(high, 1.0)], rtol=1e-12)
    assert found.p == pytest.approx(2 * scipy.stats.t.sf(0.8125 / error, 3))
    # A test-to-training ratio of 0 gives the ordinary one-sample t test of the mean.
    plain = scipy.stats.ttest_1samp(values, 0, nan_policy="omit")
    assert confidence_intervals.estimate_mean(values, 0.0).p == pytest.approx(plain.pvalue)


def test_the_interval_of_a_proportion_uses_logits_and_stays_in_range():
    narrow = 0.9 + 1e-4 * np.array([-1.0, 0.0, 1.0])
    plain, found = (
        confidence_intervals.estimate_mean(narrow, 0.2),
        confidence_intervals.estimate_proportion(narrow, 0.2),
    )
    assert_allclose([found.low, found.high], [plain.low, plain.high], atol=1e-5)
    wide = confidence_intervals.estimate_proportion(np.array([1.0, 1.0, 0.8]), 0.2)
    assert 0 < wide.low < wide.value < wide.high < 1
    assert wide.value - wide.low > wide.high - wide.value


@given(values=st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=1, max_size=8), ratio=st.floats(0, 1))
def test_the_interval_of_a_proportion_is_within_0_and_1(values, ratio):
    found = confidence_intervals.estimate_proportion(np.array(values), ratio)
    assert 0 <= found.value <= 1
    assert len(values) == 1 or 0 <= found.low <= found.value + 1e-12 <= found.high + 2e-12 <= 1 + 3e-12


def test_the_test_to_training_ratio_counts_subjects():
    parts = pd.DataFrame(
        {"repeat": [0] * 10, "subject": range(10), "part": ["training"] * 7 + ["validation"] + ["test"] * 2}
    )
    assert confidence_intervals.compute_test_train_ratio(parts) == pytest.approx(2 / 7)


def test_the_middle_of_an_interval_is_the_score_on_the_logit_scale():
    table = make_predictions()
    found = confidence_intervals.compute_arm_intervals(score_splits(table), 0.0).set_index(ARM_COLUMNS)
    scores = summarise_scores(score_splits(table)).set_index(ARM_COLUMNS)
    assert_allclose((logit(found["auc_low"]) + logit(found["auc_high"])) / 2, logit(scores["auc"]), rtol=1e-9)


def test_a_single_split_gives_no_interval():
    row = confidence_intervals.compute_arm_intervals(score_splits(make_predictions(splits=1)), 0.2).iloc[0]
    assert np.isnan(row[["auc_low", "auc_high", "macro_f1_low"]].astype(float)).all()
    assert np.isnan(confidence_intervals.estimate_mean(np.array([np.nan]), 0.2).value)


def test_interval_width_falls_with_the_square_root_of_the_subjects():
    widths = []
    for subjects in (60, 960):
        table = score_splits(make_predictions(subjects=subjects, splits=60, shift=0.8))
        row = confidence_intervals.compute_arm_intervals(table, 0.2).iloc[0]
        widths.append(row["auc_high"] - row["auc_low"])
    assert widths[0] / widths[1] == pytest.approx(4, rel=0.5)


def test_paired_differences_detect_the_worse_model():
    table = confidence_intervals.compare_arms(score_splits(make_predictions(subjects=200, splits=10)), 15 / 70)
    found = table[table["metric"] == "auc"].set_index(["comparison", "model"])
    cross = found.loc[("cross minus within", "lr")]
    assert cross["high"] < 0
    assert cross["p"] < 1e-4
    assert cross["test_subjects"] == 100
    assert 30 < cross["test_rarest"] <= 50
    assert found.loc[("model minus JSW (true)", "rf")]["high"] < 0
    # Model and JSW have the same signal with different noise.
    assert found.loc[("model minus JSW (true)", "lr"), "p"].item() > 0.01


def test_multi_protocol_training_is_compared_on_equal_test_radiographs():
    table = make_predictions()
    own = table[(table["scenario"] == "within") & (table["model"] == "lr")]
    protocol = own["tested_on"].iloc[0]
    of_all = [own.assign(scenario="multi", trained_on="all", tested_on=on) for on in (protocol, "x")]
    of_other = own.assign(scenario="cross", tested_on="x")
    found = confidence_intervals.compare_arms(score_splits(pd.concat([own, of_other, *of_all], ignore_index=True)), 0.2)
    pairs = found[found["metric"] == "auc"].groupby("comparison")["tested_on"].agg(list).to_dict()
    assert pairs["multi minus within"] == [protocol]
    assert pairs["multi minus cross"] == ["x"]


def test_the_difference_between_identical_predictions_is_zero():
    table = make_predictions()
    twin = table[(table["scenario"] == "within") & (table["model"] == "lr")].assign(scenario="cross", tested_on="x")
    both = pd.concat([table[table["scenario"] == "within"], twin], ignore_index=True)
    found = confidence_intervals.compare_arms(score_splits(both), 0.2)
    found = found[found["comparison"] == "cross minus within"]
    assert len(found) == 3
    assert (found[["difference", "low", "high"]] == 0).all(axis=None)
    assert (found["p"] == 1).all()


@settings(max_examples=8)  # Each call of multipletests runs the garbage collector.
@given(p=st.lists(st.floats(0, 1), min_size=1, max_size=20))
def test_holm_correction_agrees_with_statsmodels(p):
    assert_allclose(confidence_intervals.apply_holm(np.array(p)), multipletests(p, method="holm")[1], rtol=1e-12)


@pytest.mark.parametrize("protocols", [2, 4, 12])
def test_a_clear_difference_stays_significant_for_many_protocols(protocols):
    rng, rows = np.random.default_rng(0), []
    for k in range(protocols):
        arm = ("0 vs 2", "cross" if k else "within", "p0", f"p{k}", "lr", "l1")
        for repeat in range(20):
            score = 0.9 - 0.3 * (k > 0) + 0.02 * rng.normal()
            rows.append(
                dict(zip(ARM_COLUMNS, arm, strict=True)) | dict.fromkeys(metrics.METRICS, score) | {"repeat": repeat}
            )
    found = confidence_intervals.compare_arms(pd.DataFrame(rows).assign(test_subjects=20, test_rarest=10), 15 / 70)
    assert len(found) == 3 * (protocols - 1)
    assert (found["p_holm"] < 0.05).all()


def test_perfect_separation_gives_an_interval_without_width():
    table = make_predictions(shift=200.0)
    row = confidence_intervals.compute_arm_intervals(score_splits(table), 0.2).iloc[0]
    assert (row["auc_low"], row["auc_high"]) == (1.0, 1.0)
