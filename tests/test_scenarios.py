"""Within, cross and multi protocol, of one split: nothing leaks, and what is there is seen."""

import numpy as np
import pandas as pd
from made_up import NAMES, features

from pssf.study import StudySettings
from pssf.study.learn.protocol_scenarios import _assign_one_protocol, evaluate_split
from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.scores.split_scores import score_splits

FAST = StudySettings(selections=("l1",), models=("lr", "rf"), repeats=4)


def test_test_rows_change_nothing_that_is_learnt():
    table = features(8)
    split = split_subjects(table["subject"], table["grade"], seed=0)
    changed = table.copy()
    held_out = changed["subject"].isin(split.test)
    changed.loc[held_out, NAMES] = 1e3 * np.random.default_rng(1).normal(size=(held_out.sum(), len(NAMES)))
    both = StudySettings(selections=("l1", "mrmr"), models=("lr", "rf", "xgb"))
    one, other = (evaluate_split(0, table=t, names=NAMES, settings=both) for t in (table, changed))
    pd.testing.assert_frame_equal(one.importances, other.importances)
    assert not np.allclose(one.predictions["p0"], other.predictions["p0"])
    assert set(one.predictions["subject"]) <= set(split.test)


def test_signal_is_found_in_every_scenario_and_the_same_twice():
    table = features(10, noise=0.2)
    outcome = evaluate_split(0, table=table, names=NAMES, settings=FAST)
    scores = score_splits(outcome.predictions)
    assert set(scores["scenario"]) == {"within", "cross", "cross_stable", "cross_harmonised", "multi", "mixed"}
    models = scores[scores["selection"] != "none"]
    assert (models.loc[models["task"] == "0 vs 2", "auc"] > 0.9).all()
    pd.testing.assert_frame_equal(
        outcome.predictions, evaluate_split(0, table=table, names=NAMES, settings=FAST).predictions
    )


def test_mixed_takes_every_knee_once_and_spreads_each_grade_over_the_protocols():
    table = features(10)
    protocols = sorted(table["protocol"].unique())
    taken = table[_assign_one_protocol(table, protocols, seed=0, repeat=0)]
    assert sorted(taken["knee"]) == sorted(table["knee"].unique())
    counts = taken.groupby(["grade", "protocol"]).size().unstack()
    assert counts.shape == (table["grade"].nunique(), len(protocols))
    assert (counts.max(axis=1) - counts.min(axis=1)).max() <= 1
    # By chance, another way in another split, and whatever the order of rows.
    assert set(taken["radiograph"]) != set(
        table[_assign_one_protocol(table, protocols, seed=0, repeat=1)]["radiograph"]
    )
    turned = table[::-1]
    assert set(taken["radiograph"]) == set(
        turned[_assign_one_protocol(turned, protocols, seed=0, repeat=0)]["radiograph"]
    )


def mean_auc(table: pd.DataFrame, names: list[str], model: str, repeats: int = 6) -> float:
    quick = StudySettings(selections=("l1",), models=(model,))
    outcomes = [evaluate_split(r, table=table, names=names, settings=quick).predictions for r in range(repeats)]
    scores = score_splits(pd.concat(outcomes, ignore_index=True))
    of_model = (scores["task"] == "0 vs 2") & (scores["scenario"] == "multi") & (scores["model"] == model)
    return float(scores[of_model]["auc"].mean())


def test_permuted_labels_give_an_auc_of_a_half():
    table = features(24, noise=0.2)
    grades = np.random.default_rng(3).permutation(np.repeat([0, 1, 2], 24))
    table["grade"] = grades[table["subject"]]
    # Standard deviation of the AUC of 24 against 24 knees of chance (Hanley & McNeil 1982): sqrt((n + m + 1) / 12 n m).
    # The splits share knees, so their mean is taken to be no better than one look at all of them; four of these.
    bound = 4 * np.sqrt(49 / (12 * 24 * 24))
    assert abs(mean_auc(table, NAMES, "lr") - 0.5) < bound


def test_a_fingerprint_of_the_subject_does_not_leak_across_the_split():
    rng = np.random.default_rng(5)
    table = features(24, noise=1e9)
    table["grade"] = rng.permutation(np.repeat([0, 1, 2], 24))[table["subject"]]
    mark = rng.normal(size=(72, 3))
    for i in range(3):  # the same in all radiographs of a subject: split by radiograph, it would tell every grade
        table[f"mark{i}"] = mark[table["subject"], i]
    names = [f"mark{i}" for i in range(3)]
    assert abs(mean_auc(table, names, "rf") - 0.5) < 4 * np.sqrt(49 / (12 * 24 * 24))
    # The same study with the leak planted, each radiograph passing for a subject of its own: the mark tells nearly all.
    leaking = table.assign(subject=np.arange(len(table)))
    assert mean_auc(leaking, names, "rf", repeats=2) > 0.9
