"""Test the comparison of groups of measures on patient radiographs."""

import numpy as np
import pandas as pd
import pytest

from pssf.study.prediction import film_measures
from pssf.study.prediction.film_measures import score_film_measures

_NAMES = ["glcm_Contrast", "vot_MeanDimension@medial_subchondral"]


@pytest.fixture(autouse=True)
def _one_repetition(monkeypatch):
    """Run the cross-validation once, for speed."""
    monkeypatch.setattr(film_measures, "_REPETITIONS", 1)


def _make_films(rng, per_grade, *, jsw=True):
    """Make a table in which the joint space and GLCM contrast decrease with the grade, and VOT is noise."""
    grade = np.repeat([0, 1, 2, 3, 4], per_grade)
    count = len(grade)
    columns = {
        "subject": [f"s{n // 2}" for n in range(count)],
        "grade": grade,
        "jsw_medial_share": 0.08 - 0.015 * grade + rng.normal(0, 0.01, count),
        "jsw_lateral_share": 0.08 + rng.normal(0, 0.01, count),
        "glcm_Contrast": -grade + rng.normal(0, 4, count),
        "vot_MeanDimension@medial_subchondral": rng.normal(2.6, 0.1, count),
    }
    table = pd.DataFrame(columns)
    return table if jsw else table.drop(columns=["jsw_medial_share", "jsw_lateral_share"])


def _score(films, cohort=None, seed=3):
    """Score with few bootstrap samples."""
    return score_film_measures(
        _make_films(np.random.default_rng(1), 60) if cohort is None else cohort,
        films,
        _NAMES,
        replicates=200,
        seed=seed,
    )


def test_groups_are_trained_on_simulation_and_on_patients():
    table = _score(_make_films(np.random.default_rng(2), 40))
    found = table.set_index(["measures", "trained_on", "grade"])["auc"]
    groups = {"joint space", "radiomics", "vot", "joint space and features"}
    assert set(found.index) == {(g, t, k) for g in groups for t in ("simulation", "patients") for k in (2, 3, 4)}
    for trained_on in ("simulation", "patients"):
        assert found["joint space", trained_on, 4] > 0.99
        assert found["joint space", trained_on, 2] > 0.85
    # Noise: the AUC of 40 against 40 has a standard deviation of 0.065. In a cross-validation it may be far below 0.5,
    # because a difference in the training set has the opposite sign in the test set.
    assert abs(found["vot", "simulation", 3] - 0.5) < 0.2
    assert found["vot", "patients", 3] < 0.7
    assert (table["auc_low"] <= table["auc"]).all()
    assert (table["auc"] <= table["auc_high"]).all()
    assert (table[["negatives", "positives"]].sum(axis=1) == table["radiographs"]).all()


def test_training_on_patients_never_sees_another_radiograph_of_the_subject():
    rng = np.random.default_rng(4)
    films = _make_films(rng, 40)
    # Each subject has two equal radiographs and features without information: a leak would raise the AUC.
    films = films.groupby("subject").first().reset_index()
    films[_NAMES] = rng.normal(size=(len(films), 2))
    twice = pd.concat([films, films], ignore_index=True)
    found = _score(twice).set_index(["measures", "trained_on", "grade"])["auc"]
    assert abs(found["radiomics", "patients", 4] - 0.5) < 0.35
    assert found["radiomics", "patients", 4] < 0.8


def test_the_joint_space_is_compared_only_if_it_was_measured():
    table = _score(
        _make_films(np.random.default_rng(2), 40, jsw=False), _make_films(np.random.default_rng(1), 60, jsw=False)
    )
    assert set(table["measures"]) == {"radiomics", "vot"}


@pytest.mark.parametrize("grades", [(0, 1), (2, 3)], ids=["without a higher grade", "without grade 0"])
def test_a_contrast_without_both_grades_is_omitted(grades):
    films = _make_films(np.random.default_rng(2), 40)
    assert _score(films[films["grade"].isin(grades)]).empty


def test_few_patients_are_scored_by_models_of_simulation_alone():
    table = _score(_make_films(np.random.default_rng(2), 6))
    assert set(table["trained_on"]) == {"simulation"}


def test_the_scores_depend_only_on_the_seed():
    films = _make_films(np.random.default_rng(2), 20)
    pd.testing.assert_frame_equal(_score(films), _score(films))
