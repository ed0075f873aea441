"""Check the trivial baselines: chance, body measures and JSW."""

from numpy.testing import assert_allclose
from synthetic_features import UNSTABLE_NAMES, make_measured_cohort, make_settings

from pssf.study.learn.models.trivial_baselines import find_baseline_columns, find_baselines
from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.analyses.knee_parameters import add_sex_indicator
from pssf.study.statistics.scores.split_scores import score_splits


def test_baselines_use_the_same_test_radiographs_and_have_known_scores():
    table = add_sex_indicator(make_measured_cohort(per_grade=20))
    found = evaluate_split(0, table=table, names=UNSTABLE_NAMES, settings=make_settings()).predictions
    scores = score_splits(found)
    within = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")].set_index("model")
    assert set(within.index) == {"lr", "chance", "body", "jsw"}
    assert within.loc["chance", "auc"] == within.loc["chance", "balanced_accuracy"] == 0.5
    assert within.loc["jsw", "auc"] == 1.0
    tested = found.groupby("model")["radiograph"].agg(lambda names: tuple(sorted(set(names))))
    assert len(set(tested)) == 1


def test_the_chance_baseline_predicts_the_grade_frequencies_of_training():
    table = make_measured_cohort(per_grade=20)
    table = table[(table["grade"] != 2) | (table["subject"] < 30)]
    found = evaluate_split(0, table=table, names=UNSTABLE_NAMES, settings=make_settings()).predictions
    rows = found[(found["model"] == "chance") & (found["task"] == "0 vs 2")]
    split = split_subjects(table["subject"], table["grade"], seed=0)
    training = table[table["subject"].isin(split.training) & (table["grade"] != 1)]
    assert_allclose(rows["p1"], (training["grade"] == 2).mean())


def test_a_cohort_without_knee_measurements_has_only_chance_as_baseline():
    table = make_measured_cohort().drop(columns=["sex", "age_years", "nominal_jsw_medial_mm"])
    assert list(find_baselines(add_sex_indicator(table), UNSTABLE_NAMES)) == ["chance"]
    assert find_baseline_columns(add_sex_indicator(table)) == ["stature_mm"]
