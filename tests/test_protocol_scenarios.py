"""Check training within, across and on multiple protocols in one split: signal is detected without leakage."""

import numpy as np
import pandas as pd
import pytest
from synthetic_features import NAMES, make_features

from pssf.study import StudySettings
from pssf.study.learn.protocol_scenarios import _assign_one_protocol, evaluate_split
from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.scores.split_scores import score_splits

FAST = StudySettings(selections=("l1",), models=("lr", "rf"), repeats=4)


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(StudySettings(selections=("mrmr",), models=("lr",)), id="logistic regression"),
        # Every model with its full search of hyperparameters takes two minutes.
        pytest.param(
            StudySettings(selections=("l1", "mrmr"), models=("lr", "rf", "xgb")), id="all", marks=pytest.mark.slow
        ),
    ],
)
def test_test_rows_do_not_change_the_trained_models(settings):
    table = make_features(8)
    split = split_subjects(table["subject"], table["grade"], seed=0)
    changed = table.copy()
    held_out = changed["subject"].isin(split.test)
    changed.loc[held_out, NAMES] = 1e3 * np.random.default_rng(1).normal(size=(held_out.sum(), len(NAMES)))
    one, other = (evaluate_split(0, table=t, names=NAMES, settings=settings) for t in (table, changed))
    pd.testing.assert_frame_equal(one.importances, other.importances)
    assert not np.allclose(one.predictions["p0"], other.predictions["p0"])
    assert set(one.predictions["subject"]) <= set(split.test)


def test_signal_is_found_in_every_scenario_and_is_reproducible():
    table = make_features(10, noise=0.2)
    outcome = evaluate_split(0, table=table, names=NAMES, settings=FAST)
    scores = score_splits(outcome.predictions)
    assert set(scores["scenario"]) == {"within", "cross", "cross_stable", "cross_harmonised", "multi", "mixed"}
    models = scores[scores["selection"] != "none"]
    assert (models.loc[models["task"] == "0 vs 2", "auc"] > 0.9).all()
    pd.testing.assert_frame_equal(
        outcome.predictions, evaluate_split(0, table=table, names=NAMES, settings=FAST).predictions
    )


def test_the_mixed_scenario_uses_each_knee_once_with_balanced_protocols():
    table = make_features(10)
    protocols = sorted(table["protocol"].unique())
    selected = table[_assign_one_protocol(table, protocols, seed=0, repeat=0)]
    assert sorted(selected["knee"]) == sorted(table["knee"].unique())
    counts = selected.groupby(["grade", "protocol"]).size().unstack()
    assert counts.shape == (table["grade"].nunique(), len(protocols))
    assert (counts.max(axis=1) - counts.min(axis=1)).max() <= 1
    # The assignment of protocols is random, differs between splits and does not depend on the order of rows.
    assert set(selected["radiograph"]) != set(
        table[_assign_one_protocol(table, protocols, seed=0, repeat=1)]["radiograph"]
    )
    reversed_table = table[::-1]
    assert set(selected["radiograph"]) == set(
        reversed_table[_assign_one_protocol(reversed_table, protocols, seed=0, repeat=0)]["radiograph"]
    )


def compute_mean_auc(table: pd.DataFrame, names: list[str], model: str, repeats: int = 2) -> float:
    quick = StudySettings(selections=("l1",), models=(model,))
    outcomes = [evaluate_split(r, table=table, names=names, settings=quick).predictions for r in range(repeats)]
    scores = score_splits(pd.concat(outcomes, ignore_index=True))
    of_model = (scores["task"] == "0 vs 2") & (scores["scenario"] == "multi") & (scores["model"] == model)
    return float(scores[of_model]["auc"].mean())


def test_permuted_labels_give_an_auc_of_0_5():
    table = make_features(24, noise=0.2)
    grades = np.random.default_rng(3).permutation(np.repeat([0, 1, 2], 24))
    table["grade"] = grades[table["subject"]]
    # The bound is 4 SD; an AUC at chance level has SD sqrt((n + m + 1) / 12 n m), n = m = 24 (Hanley & McNeil 1982).
    # Splits contain the same knees, so their mean AUC is assumed to be only as precise as one AUC of all knees.
    bound = 4 * np.sqrt(49 / (12 * 24 * 24))
    assert abs(compute_mean_auc(table, NAMES, "lr") - 0.5) < bound


def test_a_feature_that_identifies_the_subject_does_not_leak_the_grade():
    rng = np.random.default_rng(5)
    table = make_features(24, noise=1e9)
    table["grade"] = rng.permutation(np.repeat([0, 1, 2], 24))[table["subject"]]
    mark = rng.normal(size=(72, 3))
    # All radiographs of a subject have the same marks, so a split by radiograph would reveal the grade.
    for i in range(3):
        table[f"mark{i}"] = mark[table["subject"], i]
    names = [f"mark{i}" for i in range(3)]
    assert abs(compute_mean_auc(table, names, "rf") - 0.5) < 4 * np.sqrt(49 / (12 * 24 * 24))
    # With a deliberate leak (each radiograph is a separate subject), the marks predict nearly all grades.
    leaking = table.assign(subject=np.arange(len(table)))
    assert compute_mean_auc(leaking, names, "rf", repeats=1) > 0.9
