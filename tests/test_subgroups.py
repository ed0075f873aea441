"""Scores of parts of the subjects."""

import numpy as np
import pandas as pd
import pytest

from pssf.study import StudySettings
from pssf.study.statistics.scores.metrics import auc
from pssf.study.statistics.scores.subgroups import COLUMNS, score_subgroups

SETTINGS = StudySettings(replicates=200, models=("lr",), selections=("l1",))


def predictions(subjects: int, repeats: int = 3) -> pd.DataFrame:
    """All subjects tested in every split; a model that is right in women (even numbers) and knows nothing in men."""
    rng, rows = np.random.default_rng(3), []
    for repeat in range(repeats):
        for subject in range(subjects):
            truth = subject // 2 % 2
            p1 = 0.2 + 0.6 * truth if subject % 2 == 0 else rng.uniform()
            arm = {"task": "0 vs 2", "scenario": "within", "trained_on": "reference", "tested_on": "reference"}
            arm |= {"model": "lr", "selection": "l1", "repeat": repeat, "subject": subject}
            rows.append(arm | {"truth": truth, "p0": 1 - p1, "p1": p1})
    return pd.DataFrame(rows)


def people(subjects: int) -> pd.DataFrame:
    number = np.arange(subjects)
    return pd.DataFrame(
        {"knee": number, "subject": number, "female": (number % 2 == 0) * 1.0, "age_years": 45.0 + number}
    )


def test_a_group_is_scored_by_itself():
    told = predictions(40)
    found = score_subgroups(told, people(40), SETTINGS, 15 / 70).set_index("group")
    assert found.loc["women", "auc"] == found.loc["women", "auc_low"] == 1.0
    men = told[told["subject"] % 2 == 1]
    by_split = [auc(part["truth"].to_numpy() == 1, part["p1"].to_numpy()) for _, part in men.groupby("repeat")]
    assert found.loc["men", "auc"] == pytest.approx(np.mean(by_split))
    assert found.loc["men", "auc_low"] < found.loc["men", "auc"] < found.loc["men", "auc_high"] <= 1.0
    assert found["subjects"].tolist() == [20, 20, 20, 20]
    assert list(found.index) == ["women", "men", "up to 64 years", "over 64 years"]


def test_a_group_without_a_grade_has_no_score():
    told = predictions(40)
    told = told[(told["subject"] % 2 == 0) | (told["truth"] == 0)]
    found = score_subgroups(told, people(40), SETTINGS, 15 / 70).set_index("group")
    assert np.isnan(found.loc["men", ["auc", "auc_low", "auc_high"]].astype(float)).all()
    assert found.loc["women", "auc"] == 1.0


def test_without_sex_and_age_there_are_no_groups():
    found = score_subgroups(predictions(8), people(8)[["knee", "subject"]], SETTINGS, 15 / 70)
    assert found.empty
    assert list(found.columns) == COLUMNS


@pytest.mark.parametrize(("subjects", "told"), [(10, False), (12, True)])
def test_a_group_of_which_splits_test_fewer_than_six_has_no_interval(subjects, told):
    found = score_subgroups(predictions(subjects), people(subjects), SETTINGS, 15 / 70).set_index("group").loc["men"]
    assert np.isfinite(found["auc"])
    assert np.isfinite(found["auc_low"]) == told


@pytest.mark.parametrize(
    ("tested", "decided"), [((4, 4, 4, 14, 14), False), ((4, 4, 6, 6, 6), True), ((0, 0, 8), False)]
)
def test_what_splits_test_of_a_group_is_their_median_and_none_counts(tested, decided):
    told = predictions(40, repeats=len(tested))
    men = told[told["subject"] % 2 == 1]
    # Of each split as many of either grade, the first ones.
    place = men.groupby(["repeat", "truth"]).cumcount()
    men = men[place < men["repeat"].map(dict(enumerate(tested))) // 2]
    found = score_subgroups(pd.concat([told[told["subject"] % 2 == 0], men]), people(40), SETTINGS, 15 / 70)
    assert np.isfinite(found.set_index("group").loc["men", "auc_low"]) == decided


def test_a_group_of_which_splits_test_fewer_than_three_of_a_grade_has_no_interval():
    told = predictions(40)
    men = told["subject"] % 2 == 1
    for kept, expected in ((3, True), (2, False)):
        few = told[~(men & (told["truth"] == 1)) | (told["subject"] < 4 * kept)]
        found = score_subgroups(few, people(40), SETTINGS, 15 / 70).set_index("group").loc["men"]
        assert np.isfinite(found["auc"])
        assert np.isfinite(found["auc_low"]) == expected
