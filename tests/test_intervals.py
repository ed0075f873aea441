"""Intervals and differences by the bootstrap of subjects."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from statsmodels.stats.multitest import multipletests

from pssf.study.predictions import ARM
from pssf.study.statistics import intervals, metrics
from pssf.study.statistics.scores import score_splits, summarise


def predictions(*, subjects: int = 30, splits: int = 4, shift: float = 1.5, seed: int = 0) -> pd.DataFrame:
    """0 vs 2, within and across, of models `lr` (better) and `rf`, and the JSW baseline; two knees a subject."""
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
def test_weighted_scores_are_those_of_rows_written_out(classes, rows, seed):
    rng = np.random.default_rng(seed)
    truth = rng.integers(classes, size=rows)
    probability = rng.dirichlet(np.ones(classes), rows).round(1)  # with ties
    weight = rng.integers(0, 4, (rows, 5)).astype(float)
    found = metrics.weighted_scores(truth, probability, weight)
    for sample in range(5):
        written = np.repeat(np.arange(rows), weight[:, sample].astype(int))
        expected = metrics.score(truth[written], probability[written])
        for metric, values in found.items():
            assert_allclose(values[sample], expected[metric], rtol=1e-12, err_msg=metric)


def test_replicates_are_those_of_a_plain_loop_over_samples_and_splits():
    table = predictions()
    weights = intervals.subject_weights(table, replicates=12, seed=3)
    replicates = intervals.resample(table, replicates=12, seed=3)
    for index, arm in enumerate(replicates.arms):
        part = table[(table[ARM] == list(arm)).all(axis=1)]
        for sample in range(13):
            of_splits = []
            for _, split in part.groupby("repeat"):
                drawn = np.repeat(np.arange(len(split)), weights.loc[split["subject"], sample].astype(int))
                rows = split.iloc[drawn]
                of_splits.append(metrics.score(rows["truth"].to_numpy(), rows[["p0", "p1"]].to_numpy())["auc"])
            assert_allclose(replicates.scores["auc"][index, sample], np.nanmean(of_splits), rtol=1e-12)


def test_the_first_sample_is_the_cohort_and_its_scores_are_those_of_the_table():
    table = predictions()
    found = intervals.resample(table, replicates=100, seed=0)
    scores = summarise(score_splits(table)).set_index(ARM)
    for index, arm in enumerate(found.arms):
        assert_allclose(found.scores["macro_f1"][index, 0], scores.loc[arm, "macro_f1"], rtol=1e-12)


def test_samples_keep_the_number_of_subjects_of_each_grade_and_all_rows_of_a_subject():
    table = predictions()
    weights = intervals.subject_weights(table, replicates=50, seed=1)
    truth = table.groupby("subject")["truth"].max()
    for grade in (0, 1):
        assert_array_equal(weights[truth == grade].sum(axis=0), (truth == grade).sum())
    assert len(weights) == table["subject"].nunique()


def test_an_interval_of_the_auc_covers_the_true_one_as_often_as_it_says():
    # Normal scores a distance d apart have AUC Phi(d / sqrt 2); 120 cohorts at 95 % miss 6 +- 2.4, bound at 4 sd.
    from scipy.stats import norm

    missed = 0
    for seed in range(120):
        rng = np.random.default_rng(seed)
        truth = np.arange(80) % 2
        p1 = 1 / (1 + np.exp(-(1.0 * truth + rng.normal(size=80))))
        table = pd.DataFrame({"subject": np.arange(80), "truth": truth, "p0": 1 - p1, "p1": p1, "repeat": 0})
        table = table.assign(**dict(zip(ARM, ("0 vs 2", "within", "r", "r", "lr", "l1"), strict=True)))
        row = intervals.intervals(intervals.resample(table, replicates=400, seed=seed)).iloc[0]
        missed += not row["auc_low"] <= norm.cdf(1 / np.sqrt(2)) <= row["auc_high"]
    assert missed <= 6 + 4 * 2.4
    assert missed >= 1  # an interval that is far too wide misses none: 0.95 ** 120 = 0.002


def test_more_subjects_narrow_an_interval_as_the_root_of_their_number():
    widths = []
    for subjects in (60, 960):
        row = intervals.intervals(intervals.resample(predictions(subjects=subjects), replicates=400, seed=0)).iloc[0]
        widths.append(row["auc_high"] - row["auc_low"])
    assert widths[0] / widths[1] == pytest.approx(4, rel=0.5)


def test_differences_are_paired_and_find_the_worse_arm():
    table = intervals.differences(intervals.resample(predictions(subjects=200), replicates=500, seed=0))
    found = table[table["metric"] == "auc"].set_index(["comparison", "model"])
    cross = found.loc[("cross minus within", "lr")]
    assert cross["high"] < 0
    assert cross["p"] == pytest.approx(2 / 501)
    assert found.loc[("model minus JSW (true)", "rf")]["high"] < 0
    assert found.loc[("model minus JSW (true)", "lr"), "p"].item() > 0.01  # same strength, other noise


def test_an_arm_does_not_differ_from_itself():
    table = predictions()
    twin = table[(table["scenario"] == "within") & (table["model"] == "lr")].assign(scenario="cross", tested_on="x")
    both = pd.concat([table[table["scenario"] == "within"], twin], ignore_index=True)
    found = intervals.differences(intervals.resample(both, replicates=200, seed=0))
    found = found[found["comparison"] == "cross minus within"]
    assert len(found) == 3
    assert (found[["difference", "low", "high"]] == 0).all(axis=None)
    assert (found["p"] == 1).all()


def test_p_is_uniform_where_nothing_differs():
    # 200 p-values of chance: below 0.05 fall 10 +- 3.1; the bootstrap of a mean of 60 is near that, bound at 4 sd.
    rng = np.random.default_rng(0)
    small = 0
    for _ in range(200):
        sample = rng.normal(size=60)
        means = sample[rng.integers(60, size=(400, 60))].mean(axis=1)
        small += intervals.p_value(means) < 0.05
    assert 1 <= small <= 23


def test_p_without_any_replicate_is_undefined():
    assert np.isnan(intervals.p_value(np.full(5, np.nan)))


@settings(max_examples=30)
@given(p=st.lists(st.floats(0, 1), min_size=1, max_size=20))
def test_holm_is_that_of_statsmodels(p):
    assert_allclose(intervals.holm(np.array(p)), multipletests(p, method="holm")[1], rtol=1e-12)


def test_classes_that_are_perfectly_told_apart_have_an_interval_of_no_width():
    table = predictions(shift=200.0)
    row = intervals.intervals(intervals.resample(table, replicates=200, seed=0)).iloc[0]
    assert (row["auc_low"], row["auc_high"]) == (1.0, 1.0)
