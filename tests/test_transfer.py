"""What may help a model across protocols."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up import SHAKY_NAMES, measured_cohort, settings_of
from numpy.testing import assert_allclose

from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.protocol_transfer import find_stable_features, harmonise_features
from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.scores.split_scores import score_splits


@settings(max_examples=20)
@given(scale=st.floats(0.1, 10), shift=st.floats(-100, 100), seed=st.integers(0, 100))
def test_harmonising_undoes_a_shift_and_scale_of_the_protocol(scale, shift, seed):
    onto = pd.DataFrame(np.random.default_rng(seed).normal(size=(15, 3)), columns=list("abc"))
    of = onto * scale + shift
    assert_allclose(harmonise_features(of, of, onto), onto, atol=1e-9)
    assert_allclose(harmonise_features(of.head(2), of, onto), onto.head(2), atol=1e-9)


def test_a_feature_that_never_varies_is_shifted_and_not_scaled():
    of, onto = pd.DataFrame({"a": [2.0, 2.0]}), pd.DataFrame({"a": [1.0, 3.0]})
    assert_allclose(harmonise_features(of, of, onto)["a"], 2.0)


def test_stable_features_are_those_that_agree_across_protocols():
    table = measured_cohort()
    assert find_stable_features(table, SHAKY_NAMES, ["a", "b"]) == ["signal", *[f"n{i}" for i in range(4)]]
    assert find_stable_features(measured_cohort(shift=30.0), SHAKY_NAMES, ["a", "b"]) == []


def test_a_knee_of_which_a_feature_is_not_known_is_left_out_of_its_icc():
    table = measured_cohort()
    table.loc[(table["knee"] == table["knee"].iloc[0]) & (table["protocol"] == "b"), "signal"] = np.nan
    assert "signal" in find_stable_features(table, SHAKY_NAMES, ["a", "b"])


def auc_of(table: pd.DataFrame, scenario: str) -> float:
    scores = score_splits(evaluate_split(0, table=table, names=SHAKY_NAMES, settings=settings_of()).predictions)
    found = scores[(scores["task"] == "0/1/2") & (scores["scenario"] == scenario) & (scores["model"] == "lr")]
    return float(found["balanced_accuracy"].mean())


def test_harmonising_gives_back_what_a_shift_of_the_protocol_costs():
    table = measured_cohort(per_grade=20, shift=30.0)
    assert auc_of(table, "within") > 0.8
    assert auc_of(table, "cross") == pytest.approx(1 / 3, abs=0.05)  # all are called one grade
    assert auc_of(table, "cross_harmonised") > 0.8


def test_options_learn_nothing_from_test_subjects_and_from_no_label_of_the_other_protocol():
    table = measured_cohort()
    split = split_subjects(table["subject"], table["grade"], seed=0)
    changed = table.copy()
    held = changed["subject"].isin([*split.test, *split.validation])
    changed.loc[held, "n0"] = 1e3 * np.random.default_rng(1).normal(size=held.sum())
    one, other = (evaluate_split(0, table=t, names=SHAKY_NAMES, settings=settings_of()) for t in (table, changed))
    assert one.stable_feature_count == other.stable_feature_count == 5


def test_a_test_subject_changes_no_prediction_but_its_own_in_any_scenario():
    table = measured_cohort(shift=3.0)
    one_of_them = split_subjects(table["subject"], table["grade"], seed=0).test[0]
    changed = table.copy()
    changed.loc[changed["subject"] == one_of_them, SHAKY_NAMES] += 100.0
    before, after = (
        evaluate_split(0, table=t, names=SHAKY_NAMES, settings=settings_of()).predictions for t in (table, changed)
    )
    others = before["subject"] != one_of_them
    pd.testing.assert_frame_equal(before[others], after[others])
    assert not before[~others].equals(after[~others])
