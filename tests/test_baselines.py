"""What a model of the image must do better than."""

from made_up import SHAKY_NAMES, measured_cohort, settings_of
from numpy.testing import assert_allclose

from pssf.study.learn.models.trivial_baselines import find_baseline_columns, find_baselines
from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.analyses.knee_parameters import add_sex_indicator
from pssf.study.statistics.scores.split_scores import score_splits


def test_baselines_pass_through_the_same_splits_and_are_what_they_say():
    table = add_sex_indicator(measured_cohort(per_grade=20))
    found = evaluate_split(0, table=table, names=SHAKY_NAMES, settings=settings_of()).predictions
    scores = score_splits(found)
    within = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")].set_index("model")
    assert set(within.index) == {"lr", "chance", "body", "jsw"}
    assert within.loc["chance", "auc"] == within.loc["chance", "balanced_accuracy"] == 0.5
    assert within.loc["jsw", "auc"] == 1.0
    tested = found.groupby("model")["radiograph"].agg(lambda names: tuple(sorted(set(names))))
    assert len(set(tested)) == 1


def test_chance_gives_the_shares_of_the_grades_in_training():
    table = measured_cohort(per_grade=20)
    table = table[(table["grade"] != 2) | (table["subject"] < 30)]
    found = evaluate_split(0, table=table, names=SHAKY_NAMES, settings=settings_of()).predictions
    rows = found[(found["model"] == "chance") & (found["task"] == "0 vs 2")]
    split = split_subjects(table["subject"], table["grade"], seed=0)
    training = table[table["subject"].isin(split.training) & (table["grade"] != 1)]
    assert_allclose(rows["p1"], (training["grade"] == 2).mean())


def test_a_cohort_without_measures_has_chance_alone():
    table = measured_cohort().drop(columns=["sex", "age_years", "nominal_jsw_medial_mm"])
    assert list(find_baselines(add_sex_indicator(table), SHAKY_NAMES)) == ["chance"]
    assert find_baseline_columns(add_sex_indicator(table)) == ["stature_mm"]
