"""Patient radiographs as an external test set of the study."""

import dataclasses
import json

import block_knee_cohort
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from sklearn.metrics import cohen_kappa_score

from pssf import study
from pssf.core.checks import InputError
from pssf.data.analysis.localisation_table import load_localisation_settings
from pssf.experiment import PatientFilms, _make_film_set
from pssf.io.patients.patient_radiographs import Film, FilmImage
from pssf.radiomics.displayed_radiograph import cut_resampled_region, locate_joint_in_display, match_template_histogram
from pssf.radiomics.localisation.crop_template import crop_template
from pssf.radiomics.localisation.joint_localisation import locate_joint
from pssf.radiomics.localisation.templates import compute_density
from pssf.study import FilmSet, StudySettings
from pssf.study.learn.models.model_file import unpack_model
from pssf.study.prediction.patient_test import _resolve_pitch_and_region_mm
from pssf.study.resume import compute_run_key
from pssf.study.statistics.scores.patient_scores import count_films_by_grade, score_films, score_grades


@pytest.fixture(scope="module")
def listed(film_study) -> pd.DataFrame:
    return pd.read_csv(film_study.tables["films"]).set_index("file")


def test_joints_are_located_on_films_of_any_side_and_polarity(listed):
    whole = listed[listed.index.str.contains("/p0")]
    assert list(whole["status"]) == ["found"] * 7
    assert (whole["film_side"] == ["left" if "L.png" in file else "right" for file in whole.index]).all()
    assert list(whole.loc[["0/p000R.png", "0/p001L.png"], "film_polarity"]) == ["bone bright", "bone dark"]
    # True pitch 0.6 mm / 0.8; the estimate assumes a plateau width of 79.1 mm instead of the true 74 mm.
    assert_allclose(whole["film_pixel_mm"], 0.75 * 79.1 / 74.0, rtol=0.04)
    assert_allclose(whole["lr_l1_0v2_films grade 0"] + whole["lr_l1_0v2_films grade 2"], 1.0)


def test_rejected_films_are_counted_by_reason_without_a_probability(film_study, listed):
    reasons = listed.loc[["0/n000R.png", "0/air1R.png", "2/torn2R.png"], "status"]
    assert list(reasons) == ["leaves image", "no knee", "unreadable"]
    assert listed.loc[reasons.index, "lr_l1_0v2_films grade 2"].isna().all()
    total = count_films_by_grade(listed).set_index("grade").loc["all"]
    assert (total["films"], total["found"]) == (10, 7)
    assert (total["leaves image"], total["no knee"], total["unreadable"]) == (1, 1, 1)
    page = film_study.report.read_text(encoding="utf-8")
    for reason in reasons:
        assert f">{reason}</th>" in page


def test_films_are_scored_for_each_comparison_of_available_grades(film_study, listed):
    scores = pd.read_csv(film_study.tables["films_scores"]).set_index("contrast")
    assert list(scores.index) == ["0 vs 2", "0 vs 3+4"]
    for contrast, grade in (("0 vs 2", 2), ("0 vs 3+4", 3)):
        found = listed[(listed["status"] == "found")]
        p = found["lr_l1_0v2_films grade 2"]
        pairs = p[found["grade"] == grade].to_numpy()[:, None] - p[found["grade"] == 0].to_numpy()
        assert scores.loc[contrast, "auc"] == ((pairs > 0) + 0.5 * (pairs == 0)).mean()
        assert (scores.loc[contrast, "negatives"], scores.loc[contrast, "positives"]) == (2, 2)


def test_report_and_checklist_include_the_films(film_study):
    page = film_study.report.read_text(encoding="utf-8")
    assert 'id="films"' in page
    assert "There are no external data" not in page
    assert "films" in film_study.pictures
    items = json.loads((film_study.report.parent / "checklist.json").read_text())["items"]
    external = [item for item in items if item["item"].lower() == "external testing"]
    assert {item["status"] for item in external} == {"yes"}


def test_a_second_run_rereads_no_film_and_writes_identical_files(film_study, tmp_path):
    for name in ("features", "displays", "films_features"):
        (tmp_path / f"{name}.csv").write_bytes((film_study.report.parent / f"{name}.csv").read_bytes())
    loaded: list[str] = []

    def load(file: str) -> FilmImage:
        loaded.append(file)
        raise InputError("film = not to be read; allowed: none")

    folder = film_study.report.parents[1] / "films"
    resolution = {"pixel_mm": _get_pitch_mm(film_study), "region_mm": 48.0}
    films = block_knee_cohort.make_film_set(folder, load=load, load_cohort=load, **resolution)
    again = study.run(
        block_knee_cohort.select_text_subjects(),
        block_knee_cohort.make_cohort().load,
        [block_knee_cohort.TEMPLATE],
        block_knee_cohort.LIGHT,
        tmp_path,
        films=films,
    )
    assert loaded == []
    for kind in ("tables", "pictures", "models"):
        for name, path in getattr(film_study, kind).items():
            assert getattr(again, kind)[name].read_bytes() == path.read_bytes(), name


def _get_pitch_mm(result) -> float:
    return unpack_model(result.models["lr_l1_0v2_films"].read_bytes(), "").card.pixel_mm


def test_films_and_simulations_use_the_coarser_pixel_size(film_study, listed):
    assert _get_pitch_mm(film_study) == round(listed["film_pixel_mm"].median(), 2)


def test_the_region_of_interest_is_reduced_to_fit_the_films():
    image = block_knee_cohort.make_cohort().display(block_knee_cohort.select_text_subjects()["file"].iloc[0])
    found = locate_joint_in_display(
        image.pixels, [block_knee_cohort.TEMPLATE], load_localisation_settings(), image.side, 0.6
    )
    above = 30
    cut = dataclasses.replace(image, pixels=image.pixels[round(found.row) - above :])
    options = {"load": lambda file: cut, "load_cohort": fail_to_read, "protocol": "reference"}
    own = Film(file="f.png", grade=0, subject="f", side=None, pixel_mm=None, sha256="")
    films = FilmSet(films=(own,), **options)
    pixel_mm, region_mm = _resolve_pitch_and_region_mm(
        films, [block_knee_cohort.TEMPLATE], load_localisation_settings(), 0.3, 76.8
    )
    assert pixel_mm == 0.6
    assert_allclose(region_mm, 2 * above * 0.6, atol=1.5)
    assert _resolve_pitch_and_region_mm(
        films, [block_knee_cohort.TEMPLATE], load_localisation_settings(), 0.9, 30.0
    ) == (0.9, 30.0)
    mine = dataclasses.replace(films, region_mm=25.0)
    assert _resolve_pitch_and_region_mm(
        mine, [block_knee_cohort.TEMPLATE], load_localisation_settings(), 0.3, 76.8
    ) == (0.6, 25.0)


@pytest.mark.parametrize(
    ("films", "settings", "template", "why"),
    [
        ({"protocol": "refrence"}, {}, {}, "films_protocol must be one of .*, got 'refrence'"),
        ({}, {"families": ("firstorder",)}, {}, "with films, got firstorder"),
        ({}, {}, {"plateau_mm": None}, "plateau_mm = None"),
    ],
)
def test_unsuitable_films_raise_an_error_before_any_measurement(film_study, tmp_path, films, settings, template, why):
    own = block_knee_cohort.make_film_set(film_study.report.parents[1] / "films", **films)
    study_settings = dataclasses.replace(block_knee_cohort.LIGHT, **settings)
    templates = [dataclasses.replace(block_knee_cohort.TEMPLATE, **template)]
    with pytest.raises(InputError, match=why):
        study.run(
            block_knee_cohort.select_text_subjects(),
            block_knee_cohort.make_cohort().load,
            templates,
            study_settings,
            tmp_path,
            films=own,
        )
    assert not list(tmp_path.iterdir())


def test_a_film_set_without_films_or_with_an_invalid_pitch_raises_an_error():
    options = {"load": fail_to_read, "load_cohort": fail_to_read, "protocol": "reference"}
    with pytest.raises(InputError, match="films must contain at least one patient radiograph, got 0"):
        FilmSet(films=(), **options)
    for name, value in (("pixel_mm", 0.0001), ("region_mm", 5.0)):
        with pytest.raises(InputError, match=f"{name} must be .*, got {value}"):
            FilmSet(films=("a film",), **{name: value}, **options)


def fail_to_read(file: str) -> FilmImage:
    raise AssertionError(file)


def test_films_use_the_reference_protocol_unless_another_is_specified(tmp_path):
    block_knee_cohort.write_film(tmp_path / "0" / "p1R.png", 0, "right", 0)
    settings = StudySettings(reference="a")
    assert _make_film_set(PatientFilms(folder=tmp_path), tmp_path, ["a", "b"], settings).protocol == "a"
    assert _make_film_set(PatientFilms(folder=tmp_path, protocol="b"), tmp_path, ["a", "b"], settings).protocol == "b"
    with pytest.raises(InputError, match="films_protocol must be one of a, b, got 'c'"):
        _make_film_set(PatientFilms(folder=tmp_path, protocol="c"), tmp_path, ["a", "b"], settings)
    with pytest.raises(InputError, match="must contain subfolders named 0 to 4"):
        _make_film_set(PatientFilms(folder=tmp_path / "nowhere"), tmp_path, ["a", "b"], settings)


def test_the_key_of_a_run_changes_with_the_films(film_study):
    folder = film_study.report.parents[1] / "films"
    keys = {
        compute_run_key([], StudySettings(), "scanline", films)
        for films in (
            None,
            block_knee_cohort.make_film_set(folder),
            block_knee_cohort.make_film_set(folder, pixel_mm=0.5),
        )
    }
    assert len(keys) == 3


@pytest.mark.parametrize("tone", [np.sqrt, np.square, lambda grey: 0.2 + 0.5 * np.tanh(3 * grey)])
def test_the_signal_does_not_depend_on_the_tone_curve_of_the_display(tone):
    region = np.random.default_rng(0).random((40, 40))
    np.testing.assert_array_equal(
        match_template_histogram(tone(region), block_knee_cohort.TEMPLATE, 0.6),
        match_template_histogram(region, block_knee_cohort.TEMPLATE, 0.6),
    )


def test_a_display_image_is_converted_to_signal_by_template_histogram():
    region = np.random.default_rng(0).random((40, 40))
    signal = match_template_histogram(region, block_knee_cohort.TEMPLATE, 0.6)
    order = np.argsort(region.ravel())
    assert (np.diff(signal.ravel()[order].astype(int)) <= 0).all()
    own = block_knee_cohort.TEMPLATE.pixels[108:148, 120:160]
    assert_allclose(np.percentile(signal, [5, 50, 95]), np.percentile(own, [5, 50, 95]), rtol=0.02)


def test_a_resampled_region_is_centred_on_the_joint_within_the_film():
    pixels = block_knee_cohort.make_cohort().display(block_knee_cohort.select_text_subjects()["file"].iloc[0]).pixels
    found = locate_joint_in_display(pixels, [block_knee_cohort.TEMPLATE], load_localisation_settings(), None, 0.6)
    same = cut_resampled_region(pixels, found, 0.6, 60)
    coarse = cut_resampled_region(pixels, found, 1.2, 30)
    means = same.reshape(30, 2, 30, 2).mean(axis=(1, 3))
    # The coarse region is centred on the joint line, but means of four fine pixels are shifted by half a fine pixel.
    assert np.corrcoef(means.ravel(), coarse.ravel())[0, 1] > 0.97
    assert cut_resampled_region(pixels, found, 0.6, 240) is None


def test_resampling_removes_noise_finer_than_the_new_pitch():
    noise = np.random.default_rng(1).random((200, 200))
    found = locate_joint_in_display(
        block_knee_cohort.make_cohort().display(block_knee_cohort.select_text_subjects()["file"].iloc[0]).pixels,
        [block_knee_cohort.TEMPLATE],
        load_localisation_settings(),
        None,
        0.6,
    )
    centred = type(found)(**vars(found) | {"row": 100.0, "col": 100.0})
    assert cut_resampled_region(noise, centred, 2.4, 40).std() < 0.25 * noise.std()


@pytest.mark.parametrize("pitch", [0.15, 0.6])
def test_the_joint_on_a_fine_display_is_reported_in_its_own_pixels(pitch):
    film = block_knee_cohort.make_cohort().display(block_knee_cohort.select_text_subjects()["file"].iloc[0])
    fine = np.kron(film.pixels, np.ones((round(0.6 / pitch),) * 2))
    found = locate_joint_in_display(fine, [block_knee_cohort.TEMPLATE], load_localisation_settings(), film.side, pitch)
    coarse = locate_joint_in_display(
        film.pixels, [block_knee_cohort.TEMPLATE], load_localisation_settings(), film.side, 0.6
    )
    step = round(0.6 / pitch)
    assert found.status == "found"
    assert_allclose([found.row, found.col], [at * step + (step - 1) / 2 for at in (coarse.row, coarse.col)], atol=step)


def test_a_cropped_template_finds_the_same_joint():
    whole = block_knee_cohort.TEMPLATE
    small = crop_template(whole, 48.0, load_localisation_settings())
    assert small.pixels.size <= whole.pixels.size
    pixels = block_knee_cohort.make_cohort().load(block_knee_cohort.select_text_subjects()["file"].iloc[1])
    side = block_knee_cohort.select_text_subjects()["side"].iloc[1]
    one, other = (
        locate_joint(compute_density(pixels), [t], load_localisation_settings(), side=side, pixel_mm=0.6)
        for t in (whole, small)
    )
    assert_allclose([one.row, one.col, one.score], [other.row, other.col, other.score], rtol=1e-4)


def make_predictions(rows) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["subject", "grade", "p"])
    return table.assign(task="0 vs 2", model="lr", selection="l1")


def test_film_scores_have_intervals_only_with_enough_subjects():
    rows = [("a", 0, 0.1), ("b", 0, 0.6), ("c", 2, 0.55), ("d", 2, 0.9), ("d", 2, 0.8), ("e", 4, 0.7), ("f", 1, 0.0)]
    scores = score_films(make_predictions(rows), replicates=200, seed=0).set_index("contrast")
    assert scores.loc["0 vs 2", "auc"] == 5 / 6
    assert scores.loc["0 vs 2", "balanced_accuracy"] == 0.75
    assert (scores.loc["0 vs 2", "radiographs"], scores.loc["0 vs 2", "subjects"]) == (5, 4)
    assert scores.loc["0 vs 2", "auc_low"] < 5 / 6 < scores.loc["0 vs 2", "auc_high"]
    assert scores.loc["0 vs 3+4", "auc"] == 1.0
    assert np.isnan(scores.loc["0 vs 3+4", "auc_low"])


def test_predictions_of_five_grades_are_scored_by_weighted_kappa():
    grades = [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    predicted = [0, 1, 1, 1, 2, 3, 3, 1, 4, 4]
    rows = pd.DataFrame(np.eye(5)[predicted], columns=[f"p{k}" for k in range(5)])
    rows = rows.assign(subject=list("abcdefghij"), grade=grades, task="0/1/2/3/4", model="lr", selection="l1")
    (scores,) = score_grades(rows, replicates=200, seed=0).to_dict("records")
    assert scores["kappa"] == pytest.approx(cohen_kappa_score(grades, predicted, weights="quadratic"))
    assert scores["kappa_low"] < scores["kappa"] < scores["kappa_high"]
    assert scores["balanced_accuracy"] == pytest.approx(0.7)
    assert (scores["radiographs"], scores["subjects"], scores["task"]) == (10, 10, "0/1/2/3/4")
    (without,) = score_grades(rows[rows["grade"] != 4], replicates=200, seed=0).to_dict("records")
    assert without["kappa"] == pytest.approx(cohen_kappa_score(grades[:8], predicted[:8], weights="quadratic"))
    assert np.isfinite([without["kappa_low"], without["kappa_high"]]).all()
    assert np.isnan([without["balanced_accuracy"], without["auc_low"]]).all()
    (single,) = score_grades(rows[1:], replicates=200, seed=0).to_dict("records")
    assert np.isfinite(single["kappa"])
    assert np.isnan(single["kappa_low"])
    assert score_grades(rows[rows["grade"] == 1], replicates=200, seed=0).empty
    three = rows[["subject", "grade", "model", "selection", "p0", "p1", "p2"]].assign(task="0/1/2")
    assert score_grades(three, replicates=200, seed=0)["radiographs"].tolist() == [6]


def test_films_of_only_one_class_of_a_contrast_give_no_score():
    assert score_films(make_predictions([("a", 2, 0.5), ("b", 3, 0.1)]), replicates=100, seed=0).empty
    assert score_films(make_predictions([]), replicates=100, seed=0).empty


def test_the_bootstrap_resamples_subjects_with_all_their_films():
    """Check that forty films per subject give an interval of the same width as one film per subject."""
    few = [(f"{grade}{k}", grade, 0.3 + 0.05 * k + 0.1 * (grade == 2)) for grade in (0, 2) for k in range(6)]
    many = [row for row in few for _ in range(40)]
    one, other = (score_films(make_predictions(rows), replicates=500, seed=1).iloc[0] for rows in (few, many))
    assert_allclose([one["auc_low"], one["auc_high"]], [other["auc_low"], other["auc_high"]])


def test_models_of_every_task_are_scored_on_every_contrast():
    rows = make_predictions([("a", 0, 0.1), ("b", 0, 0.4), ("c", 2, 0.3), ("d", 3, 0.8), ("e", 4, 0.9), ("f", 2, 0.6)])
    both = pd.concat([rows, rows.assign(task="0 vs 3+4", p=1 - rows["p"])], ignore_index=True)
    scores = score_films(both, replicates=100, seed=0).set_index(["contrast", "task"])["auc"]
    assert scores.to_dict() == {
        ("0 vs 2", "0 vs 2"): 0.75,
        ("0 vs 2", "0 vs 3+4"): 0.25,
        ("0 vs 3+4", "0 vs 2"): 1.0,
        ("0 vs 3+4", "0 vs 3+4"): 0.0,
    }
