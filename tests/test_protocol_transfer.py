"""Check transfer across protocols: stable features and harmonisation."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from synthetic_features import UNSTABLE_NAMES, make_measured_cohort, make_settings

from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.protocol_transfer import find_stable_features, harmonise_features
from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.scores.split_scores import score_splits


@settings(max_examples=20)
@given(scale=st.floats(0.1, 10), shift=st.floats(-100, 100), seed=st.integers(0, 100))
def test_harmonisation_removes_shift_and_scale_between_protocols(scale, shift, seed):
    onto = pd.DataFrame(np.random.default_rng(seed).normal(size=(15, 3)), columns=list("abc"))
    of = onto * scale + shift
    assert_allclose(harmonise_features(of, of, onto), onto, atol=1e-9)
    assert_allclose(harmonise_features(of.head(2), of, onto), onto.head(2), atol=1e-9)


def test_harmonisation_shifts_but_does_not_scale_a_constant_feature():
    of, onto = pd.DataFrame({"a": [2.0, 2.0]}), pd.DataFrame({"a": [1.0, 3.0]})
    assert_allclose(harmonise_features(of, of, onto)["a"], 2.0)


def test_stable_features_are_those_that_agree_across_protocols():
    table = make_measured_cohort()
    assert find_stable_features(table, UNSTABLE_NAMES, ["a", "b"]) == ["signal", *[f"n{i}" for i in range(4)]]
    assert find_stable_features(make_measured_cohort(shift=30.0), UNSTABLE_NAMES, ["a", "b"]) == []


def test_a_knee_with_a_missing_feature_is_left_out_of_its_icc():
    table = make_measured_cohort()
    table.loc[(table["knee"] == table["knee"].iloc[0]) & (table["protocol"] == "b"), "signal"] = np.nan
    assert "signal" in find_stable_features(table, UNSTABLE_NAMES, ["a", "b"])


def compute_balanced_accuracy(table: pd.DataFrame, scenario: str) -> float:
    scores = score_splits(evaluate_split(0, table=table, names=UNSTABLE_NAMES, settings=make_settings()).predictions)
    found = scores[(scores["task"] == "0/1/2") & (scores["scenario"] == scenario) & (scores["model"] == "lr")]
    return float(found["balanced_accuracy"].mean())


def test_harmonisation_restores_the_accuracy_lost_by_a_protocol_shift():
    table = make_measured_cohort(per_grade=20, shift=30.0)
    assert compute_balanced_accuracy(table, "within") > 0.8
    # The protocol shift makes the model predict the same grade for all knees.
    assert compute_balanced_accuracy(table, "cross") == pytest.approx(1 / 3, abs=0.05)
    assert compute_balanced_accuracy(table, "cross_harmonised") > 0.8


def test_stable_features_do_not_depend_on_test_subjects():
    table = make_measured_cohort()
    split = split_subjects(table["subject"], table["grade"], seed=0)
    changed = table.copy()
    held_out = changed["subject"].isin([*split.test, *split.validation])
    changed.loc[held_out, "n0"] = 1e3 * np.random.default_rng(1).normal(size=held_out.sum())
    one, other = (evaluate_split(0, table=t, names=UNSTABLE_NAMES, settings=make_settings()) for t in (table, changed))
    assert one.stable_feature_count == other.stable_feature_count == 5


def test_a_test_subject_changes_only_its_own_predictions():
    table = make_measured_cohort(shift=3.0)
    test_subject = split_subjects(table["subject"], table["grade"], seed=0).test[0]
    changed = table.copy()
    changed.loc[changed["subject"] == test_subject, UNSTABLE_NAMES] += 100.0
    before, after = (
        evaluate_split(0, table=t, names=UNSTABLE_NAMES, settings=make_settings()).predictions for t in (table, changed)
    )
    others = before["subject"] != test_subject
    pd.testing.assert_frame_equal(before[others], after[others])
    assert not before[~others].equals(after[~others])
