"""Check scores of subgroups of subjects by sex and age."""

import numpy as np
import pandas as pd
import pytest

from pssf.study import StudySettings
from pssf.study.statistics.scores.metrics import auc
from pssf.study.statistics.scores.subgroups import COLUMNS, score_subgroups

SETTINGS = StudySettings(replicates=200, models=("lr",), selections=("l1",))


def make_predictions(subjects: int, repeats: int = 3) -> pd.DataFrame:
    """Make predictions of all subjects in every split: correct in women (even numbers), random in men."""
    rng, rows = np.random.default_rng(3), []
    for repeat in range(repeats):
        for subject in range(subjects):
            truth = subject // 2 % 2
            p1 = 0.2 + 0.6 * truth if subject % 2 == 0 else rng.uniform()
            arm = {"task": "0 vs 2", "scenario": "within", "trained_on": "reference", "tested_on": "reference"}
            arm |= {"model": "lr", "selection": "l1", "repeat": repeat, "subject": subject}
            rows.append(arm | {"truth": truth, "p0": 1 - p1, "p1": p1})
    return pd.DataFrame(rows)


def make_subjects(subjects: int) -> pd.DataFrame:
    number = np.arange(subjects)
    return pd.DataFrame(
        {"knee": number, "subject": number, "female": (number % 2 == 0) * 1.0, "age_years": 45.0 + number}
    )


def test_each_subgroup_is_scored_separately():
    predictions = make_predictions(40)
    found = score_subgroups(predictions, make_subjects(40), SETTINGS, 15 / 70).set_index("group")
    assert found.loc["women", "auc"] == found.loc["women", "auc_low"] == 1.0
    men = predictions[predictions["subject"] % 2 == 1]
    by_split = [auc(part["truth"].to_numpy() == 1, part["p1"].to_numpy()) for _, part in men.groupby("repeat")]
    assert found.loc["men", "auc"] == pytest.approx(np.mean(by_split))
    assert found.loc["men", "auc_low"] < found.loc["men", "auc"] < found.loc["men", "auc_high"] <= 1.0
    assert found["subjects"].tolist() == [20, 20, 20, 20]
    assert list(found.index) == ["women", "men", "up to 64 years", "over 64 years"]


def test_a_subgroup_without_one_of_the_grades_has_no_score():
    predictions = make_predictions(40)
    predictions = predictions[(predictions["subject"] % 2 == 0) | (predictions["truth"] == 0)]
    found = score_subgroups(predictions, make_subjects(40), SETTINGS, 15 / 70).set_index("group")
    assert np.isnan(found.loc["men", ["auc", "auc_low", "auc_high"]].astype(float)).all()
    assert found.loc["women", "auc"] == 1.0


def test_subjects_of_median_age_belong_to_the_younger_subgroup():
    found = score_subgroups(make_predictions(41), make_subjects(41), SETTINGS, 15 / 70).set_index("group")
    assert found["subjects"].to_dict() == {"women": 21, "men": 20, "up to 65 years": 21, "over 65 years": 20}


def test_without_sex_and_age_there_are_no_subgroups():
    found = score_subgroups(make_predictions(8), make_subjects(8)[["knee", "subject"]], SETTINGS, 15 / 70)
    assert found.empty
    assert list(found.columns) == COLUMNS


@pytest.mark.parametrize(("subjects", "has_interval"), [(10, False), (12, True)])
def test_a_subgroup_with_fewer_than_six_test_subjects_has_no_interval(subjects, has_interval):
    found = (
        score_subgroups(make_predictions(subjects), make_subjects(subjects), SETTINGS, 15 / 70)
        .set_index("group")
        .loc["men"]
    )
    assert np.isfinite(found["auc"])
    assert np.isfinite(found["auc_low"]) == has_interval


@pytest.mark.parametrize(
    ("tested", "decided"), [((4, 4, 4, 14, 14), False), ((4, 4, 6, 6, 6), True), ((0, 0, 8), False)]
)
def test_the_median_test_set_size_determines_if_there_is_an_interval(tested, decided):
    predictions = make_predictions(40, repeats=len(tested))
    men = predictions[predictions["subject"] % 2 == 1]
    # Each split retains the first subjects, with equal numbers of both grades.
    position = men.groupby(["repeat", "truth"]).cumcount()
    men = men[position < men["repeat"].map(dict(enumerate(tested))) // 2]
    found = score_subgroups(
        pd.concat([predictions[predictions["subject"] % 2 == 0], men]), make_subjects(40), SETTINGS, 15 / 70
    )
    assert np.isfinite(found.set_index("group").loc["men", "auc_low"]) == decided


def test_a_subgroup_with_fewer_than_three_of_a_grade_has_no_interval():
    predictions = make_predictions(40)
    men = predictions["subject"] % 2 == 1
    for kept, expected in ((3, True), (2, False)):
        few = predictions[~(men & (predictions["truth"] == 1)) | (predictions["subject"] < 4 * kept)]
        found = score_subgroups(few, make_subjects(40), SETTINGS, 15 / 70).set_index("group").loc["men"]
        assert np.isfinite(found["auc"])
        assert np.isfinite(found["auc_low"]) == expected
