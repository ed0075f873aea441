"""Check models of all five grades: training, files, scores and prediction on films."""

import block_knee_cohort
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from pssf import study
from pssf.io.patients.patient_radiographs import list_films
from pssf.study.learn.models.model_file import unpack_model
from pssf.study.prediction.film_prediction import predict_films

NAME = "lr_l1_01234_films"


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    folder = tmp_path_factory.mktemp("five") / "films"
    for number in range(10):
        side = ("right", "left")[number % 2]
        block_knee_cohort.write_film(
            folder / str(number % 5) / f"p{number:03d}{'RL'[number % 2]}.png", number % 5, side, number
        )
    return folder


@pytest.fixture(scope="module")
def trained(films, tmp_path_factory):
    cohort = block_knee_cohort.Cohort(4, grades=5)
    manifest = cohort.manifest[cohort.manifest["protocol"] == "reference"]
    film_set = block_knee_cohort.make_film_set(films, load_cohort=cohort.display, pixel_mm=0.6, region_mm=48.0)
    folder = tmp_path_factory.mktemp("five_study")
    return study.run(
        manifest, cohort.load, [block_knee_cohort.TEMPLATE], block_knee_cohort.LIGHT, folder / "out", films=film_set
    )


def test_a_model_of_all_grades_predicts_five_probabilities_for_films(trained, films):
    assert {NAME, "lr_l1_01234_reference"} <= set(trained.models)
    model = unpack_model(trained.models[NAME].read_bytes(), NAME)
    assert model.card.grades == (0, 1, 2, 3, 4)
    assert model.card.grade_names[3:] == ("moderate OA", "severe OA")
    assert (model.card.subjects, model.card.task) == (20, "0/1/2/3/4")
    listed = list_films(films)
    predicted = predict_films(model, listed, films).table
    probabilities = predicted[[f"p grade {grade}" for grade in range(5)]].to_numpy()
    assert (predicted["status"] == "found").all()
    assert_allclose(probabilities.sum(axis=1), 1.0)
    errors = probabilities @ np.arange(5) - predicted["grade"].to_numpy(float)
    assert np.abs(errors).mean() < 1.0


def test_film_predictions_are_scored_by_quadratic_kappa(trained):
    scores = pd.read_csv(trained.tables["films_grades"]).set_index("task")
    assert set(scores.index) == {"0/1/2", "0/1/2/3/4"}
    five = scores.loc["0/1/2/3/4"]
    assert five["radiographs"] == 10
    assert 0.3 < five["kappa"] <= 1.0
    assert five["kappa_low"] < five["kappa_high"]
    assert five["balanced_accuracy_low"] <= five["balanced_accuracy"] <= five["balanced_accuracy_high"]
    page = trained.report.read_text(encoding="utf-8")
    assert "Quadratic kappa" in page
    assert "Confusion matrices of grades 0/1/2/3/4" in page


def test_a_cohort_of_five_grades_is_evaluated_in_every_task(trained):
    scores = pd.read_csv(trained.tables["scores"])
    assert set(scores["task"]) == {"0 vs 2", "0/1/2", "0 vs 3+4", "0/1/2/3/4"}
