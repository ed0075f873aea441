"""Films of patients as an external test of the study."""

import dataclasses
import json

import drawn
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


def test_films_are_found_whatever_their_side_polarity_and_pitch(listed):
    whole = listed[listed.index.str.contains("/p0")]
    assert list(whole["status"]) == ["found"] * 7
    assert (whole["film_side"] == ["left" if "L.png" in file else "right" for file in whole.index]).all()
    assert list(whole.loc[["0/p000R.png", "0/p001L.png"], "film_polarity"]) == ["bone bright", "bone dark"]
    # 0.6 mm over 0.8, by a plateau of 74 mm that is taken for one of 79.1.
    assert_allclose(whole["film_pixel_mm"], 0.75 * 79.1 / 74.0, rtol=0.04)
    assert_allclose(whole["lr_l1_0v2_films grade 0"] + whole["lr_l1_0v2_films grade 2"], 1.0)


def test_what_cannot_be_read_is_counted_by_its_reason_and_has_no_probability(film_study, listed):
    reasons = listed.loc[["0/n000R.png", "0/air1R.png", "2/torn2R.png"], "status"]
    assert list(reasons) == ["leaves image", "no knee", "unreadable"]
    assert listed.loc[reasons.index, "lr_l1_0v2_films grade 2"].isna().all()
    of_all = count_films_by_grade(listed).set_index("grade").loc["all"]
    assert (of_all["films"], of_all["found"]) == (10, 7)
    assert (of_all["leaves image"], of_all["no knee"], of_all["unreadable"]) == (1, 1, 1)
    page = film_study.report.read_text(encoding="utf-8")
    for reason in reasons:
        assert f">{reason}</th>" in page


def test_films_are_scored_for_each_contrast_that_they_have(film_study, listed):
    scores = pd.read_csv(film_study.tables["films_scores"]).set_index("films_of")
    assert list(scores.index) == ["0 vs 2", "0 vs 3+4"]
    for contrast, grade in (("0 vs 2", 2), ("0 vs 3+4", 3)):
        found = listed[(listed["status"] == "found")]
        p = found["lr_l1_0v2_films grade 2"]
        pairs = p[found["grade"] == grade].to_numpy()[:, None] - p[found["grade"] == 0].to_numpy()
        assert scores.loc[contrast, "auc"] == ((pairs > 0) + 0.5 * (pairs == 0)).mean()
        assert (scores.loc[contrast, "without"], scores.loc[contrast, "with"]) == (2, 2)


def test_report_and_checklist_tell_of_the_films(film_study):
    page = film_study.report.read_text(encoding="utf-8")
    assert 'id="films"' in page
    assert "There is no external data" not in page
    assert "films" in film_study.pictures
    items = json.loads((film_study.report.parent / "checklist.json").read_text())["items"]
    external = [item for item in items if item["item"].lower() == "external testing"]
    assert {item["status"] for item in external} == {"yes"}


def test_a_second_run_reads_no_film_again_and_writes_the_same_bytes(film_study, tmp_path):
    for name in ("features", "displays", "films_features"):
        (tmp_path / f"{name}.csv").write_bytes((film_study.report.parent / f"{name}.csv").read_bytes())
    asked: list[str] = []

    def load(file: str) -> FilmImage:
        asked.append(file)
        raise InputError("film = not to be read; allowed: none")

    folder = film_study.report.parents[1] / "films"
    chosen = {"pixel_mm": _pitch(film_study), "region_mm": 48.0}
    films = drawn.film_set(folder, load=load, load_cohort=load, **chosen)
    again = study.run(drawn.text_subjects(), drawn.cohort().load, [drawn.TEMPLATE], drawn.LIGHT, tmp_path, films=films)
    assert asked == []
    for kind in ("tables", "pictures", "models"):
        for name, path in getattr(film_study, kind).items():
            assert getattr(again, kind)[name].read_bytes() == path.read_bytes(), name


def _pitch(result) -> float:
    return unpack_model(result.models["lr_l1_0v2_films"].read_bytes(), "").card.pixel_mm


def test_cohort_and_films_are_read_at_the_films_pitch_where_it_is_coarser(film_study, listed):
    assert _pitch(film_study) == round(listed["film_pixel_mm"].median(), 2)


def test_the_region_is_what_the_films_hold_where_that_is_less_than_the_studys():
    image = drawn.cohort().display(drawn.text_subjects()["file"].iloc[0])
    found = locate_joint_in_display(image.pixels, [drawn.TEMPLATE], load_localisation_settings(), image.side, 0.6)
    above = 30
    cut = dataclasses.replace(image, pixels=image.pixels[round(found.row) - above :])
    how = {"load": lambda file: cut, "load_cohort": read_nothing, "protocol": "reference"}
    own = Film(file="f.png", grade=0, subject="f", side=None, pixel_mm=None, sha256="")
    films = FilmSet(films=(own,), **how)
    pixel_mm, region_mm = _resolve_pitch_and_region_mm(films, [drawn.TEMPLATE], load_localisation_settings(), 0.3, 76.8)
    assert pixel_mm == 0.6
    assert_allclose(region_mm, 2 * above * 0.6, atol=1.5)
    assert _resolve_pitch_and_region_mm(films, [drawn.TEMPLATE], load_localisation_settings(), 0.9, 30.0) == (0.9, 30.0)
    mine = dataclasses.replace(films, region_mm=25.0)
    assert _resolve_pitch_and_region_mm(mine, [drawn.TEMPLATE], load_localisation_settings(), 0.3, 76.8) == (0.6, 25.0)


@pytest.mark.parametrize(
    ("films", "settings", "template", "why"),
    [
        ({"protocol": "refrence"}, {}, {}, "films-protocol must be one of .*, got 'refrence'"),
        ({}, {"families": ("firstorder",)}, {}, "with films, got firstorder"),
        ({}, {}, {"plateau_mm": None}, "plateau_mm = None"),
    ],
)
def test_films_that_a_cohort_cannot_be_tested_on_are_refused_before_work(
    film_study, tmp_path, films, settings, template, why
):
    own = drawn.film_set(film_study.report.parents[1] / "films", **films)
    chosen = dataclasses.replace(drawn.LIGHT, **settings)
    templates = [dataclasses.replace(drawn.TEMPLATE, **template)]
    with pytest.raises(InputError, match=why):
        study.run(drawn.text_subjects(), drawn.cohort().load, templates, chosen, tmp_path, films=own)
    assert not list(tmp_path.iterdir())


def test_a_set_without_films_or_with_an_impossible_pitch_is_refused():
    how = {"load": read_nothing, "load_cohort": read_nothing, "protocol": "reference"}
    with pytest.raises(InputError, match="films must hold at least one patient radiograph, got 0"):
        FilmSet(films=(), **how)
    for name, value in (("pixel_mm", 0.0001), ("region_mm", 5.0)):
        with pytest.raises(InputError, match=f"{name} must be .*, got {value}"):
            FilmSet(films=("a film",), **{name: value}, **how)


def read_nothing(file: str) -> FilmImage:
    raise AssertionError(file)


def test_films_of_a_folder_learn_from_the_reference_if_no_protocol_is_named(tmp_path):
    drawn.film(tmp_path / "0" / "p1R.png", 0, "right", 0)
    settings = StudySettings(reference="a")
    assert _make_film_set(PatientFilms(folder=tmp_path), tmp_path, ["a", "b"], settings).protocol == "a"
    assert _make_film_set(PatientFilms(folder=tmp_path, protocol="b"), tmp_path, ["a", "b"], settings).protocol == "b"
    with pytest.raises(InputError, match="films-protocol must be one of a, b, got 'c'"):
        _make_film_set(PatientFilms(folder=tmp_path, protocol="c"), tmp_path, ["a", "b"], settings)
    with pytest.raises(InputError, match="must have subfolders 0 to 4"):
        _make_film_set(PatientFilms(folder=tmp_path / "nowhere"), tmp_path, ["a", "b"], settings)


def test_the_key_of_a_finished_run_changes_with_the_films(film_study):
    folder = film_study.report.parents[1] / "films"
    keys = {
        compute_run_key([], StudySettings(), "scanline", films)
        for films in (None, drawn.film_set(folder), drawn.film_set(folder, pixel_mm=0.5))
    }
    assert len(keys) == 3


@pytest.mark.parametrize("tone", [np.sqrt, np.square, lambda shown: 0.2 + 0.5 * np.tanh(3 * shown)])
def test_no_tone_curve_of_a_display_changes_the_signal(tone):
    region = np.random.default_rng(0).random((40, 40))
    np.testing.assert_array_equal(
        match_template_histogram(tone(region), drawn.TEMPLATE, 0.6),
        match_template_histogram(region, drawn.TEMPLATE, 0.6),
    )


def test_the_signal_of_a_display_is_dark_where_that_is_bright_and_as_frequent_as_in_the_template():
    region = np.random.default_rng(0).random((40, 40))
    signal = match_template_histogram(region, drawn.TEMPLATE, 0.6)
    order = np.argsort(region.ravel())
    assert (np.diff(signal.ravel()[order].astype(int)) <= 0).all()
    own = drawn.TEMPLATE.pixels[108:148, 120:160]
    assert_allclose(np.percentile(signal, [5, 50, 95]), np.percentile(own, [5, 50, 95]), rtol=0.02)


def test_a_region_is_brought_to_another_pitch_about_the_joint_line_and_leaves_no_film():
    pixels = drawn.cohort().display(drawn.text_subjects()["file"].iloc[0]).pixels
    found = locate_joint_in_display(pixels, [drawn.TEMPLATE], load_localisation_settings(), None, 0.6)
    same = cut_resampled_region(pixels, found, 0.6, 60)
    coarse = cut_resampled_region(pixels, found, 1.2, 30)
    means = same.reshape(30, 2, 30, 2).mean(axis=(1, 3))
    # The coarse pixel is centred on the joint line, the mean of four half a fine pixel beside it.
    assert np.corrcoef(means.ravel(), coarse.ravel())[0, 1] > 0.97
    assert cut_resampled_region(pixels, found, 0.6, 240) is None


def test_noise_finer_than_the_new_pitch_is_taken_away():
    noise = np.random.default_rng(1).random((200, 200))
    found = locate_joint_in_display(
        drawn.cohort().display(drawn.text_subjects()["file"].iloc[0]).pixels,
        [drawn.TEMPLATE],
        load_localisation_settings(),
        None,
        0.6,
    )
    centred = type(found)(**vars(found) | {"row": 100.0, "col": 100.0})
    assert cut_resampled_region(noise, centred, 2.4, 40).std() < 0.25 * noise.std()


@pytest.mark.parametrize("pitch", [0.15, 0.6])
def test_a_fine_display_is_looked_at_coarsely_and_told_in_its_own_pixels(pitch):
    film = drawn.cohort().display(drawn.text_subjects()["file"].iloc[0])
    fine = np.kron(film.pixels, np.ones((round(0.6 / pitch),) * 2))
    found = locate_joint_in_display(fine, [drawn.TEMPLATE], load_localisation_settings(), film.side, pitch)
    coarse = locate_joint_in_display(film.pixels, [drawn.TEMPLATE], load_localisation_settings(), film.side, 0.6)
    step = round(0.6 / pitch)
    assert found.status == "found"
    assert_allclose([found.row, found.col], [at * step + (step - 1) / 2 for at in (coarse.row, coarse.col)], atol=step)


def test_a_compact_template_finds_the_same_joint():
    whole = drawn.TEMPLATE
    small = crop_template(whole, 48.0, load_localisation_settings())
    assert small.pixels.size <= whole.pixels.size
    pixels = drawn.cohort().load(drawn.text_subjects()["file"].iloc[1])
    side = drawn.text_subjects()["side"].iloc[1]
    one, other = (
        locate_joint(compute_density(pixels), [t], load_localisation_settings(), side=side, pixel_mm=0.6)
        for t in (whole, small)
    )
    assert_allclose([one.row, one.col, one.score], [other.row, other.col, other.score], rtol=1e-4)


def predictions(rows) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["subject", "grade", "p"])
    return table.assign(task="0 vs 2", model="lr", selection="l1")


def test_scores_of_films_are_of_their_subjects_and_unknown_where_there_are_too_few():
    rows = [("a", 0, 0.1), ("b", 0, 0.6), ("c", 2, 0.55), ("d", 2, 0.9), ("d", 2, 0.8), ("e", 4, 0.7), ("f", 1, 0.0)]
    scores = score_films(predictions(rows), replicates=200, seed=0).set_index("films_of")
    assert scores.loc["0 vs 2", "auc"] == 5 / 6
    assert scores.loc["0 vs 2", "balanced_accuracy"] == 0.75
    assert (scores.loc["0 vs 2", "films"], scores.loc["0 vs 2", "subjects"]) == (5, 4)
    assert scores.loc["0 vs 2", "auc_low"] < 5 / 6 < scores.loc["0 vs 2", "auc_high"]
    assert scores.loc["0 vs 3+4", "auc"] == 1.0
    assert np.isnan(scores.loc["0 vs 3+4", "auc_low"])


def test_calls_of_five_grades_are_scored_by_kappa_and_by_the_rest_where_all_grades_are_there():
    grades = [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    calls = [0, 1, 1, 1, 2, 3, 3, 1, 4, 4]
    rows = pd.DataFrame(np.eye(5)[calls], columns=[f"p{k}" for k in range(5)])
    rows = rows.assign(subject=list("abcdefghij"), grade=grades, task="0/1/2/3/4", model="lr", selection="l1")
    (scores,) = score_grades(rows, replicates=200, seed=0).to_dict("records")
    assert scores["kappa"] == pytest.approx(cohen_kappa_score(grades, calls, weights="quadratic"))
    assert scores["kappa_low"] < scores["kappa"] < scores["kappa_high"]
    assert scores["balanced_accuracy"] == pytest.approx(0.7)
    assert (scores["films"], scores["subjects"], scores["learnt"]) == (10, 10, "0/1/2/3/4")
    (without,) = score_grades(rows[rows["grade"] != 4], replicates=200, seed=0).to_dict("records")
    assert without["kappa"] == pytest.approx(cohen_kappa_score(grades[:8], calls[:8], weights="quadratic"))
    assert np.isfinite([without["kappa_low"], without["kappa_high"]]).all()
    assert np.isnan([without["balanced_accuracy"], without["auc_low"]]).all()
    (single,) = score_grades(rows[1:], replicates=200, seed=0).to_dict("records")
    assert np.isfinite(single["kappa"])
    assert np.isnan(single["kappa_low"])
    assert score_grades(rows[rows["grade"] == 1], replicates=200, seed=0).empty
    three = rows[["subject", "grade", "model", "selection", "p0", "p1", "p2"]].assign(task="0/1/2")
    assert score_grades(three, replicates=200, seed=0)["films"].tolist() == [6]


def test_films_of_one_side_of_every_contrast_give_no_score():
    assert score_films(predictions([("a", 2, 0.5), ("b", 3, 0.1)]), replicates=100, seed=0).empty
    assert score_films(predictions([]), replicates=100, seed=0).empty


def test_a_film_counts_in_a_bootstrap_with_all_films_of_its_subject():
    """Forty films of one subject are no forty subjects: the interval is as wide as with one film of each."""
    few = [(f"{grade}{k}", grade, 0.3 + 0.05 * k + 0.1 * (grade == 2)) for grade in (0, 2) for k in range(6)]
    many = [row for row in few for _ in range(40)]
    one, other = (score_films(predictions(rows), replicates=500, seed=1).iloc[0] for rows in (few, many))
    assert_allclose([one["auc_low"], one["auc_high"]], [other["auc_low"], other["auc_high"]])


def test_models_of_every_task_are_scored_on_every_contrast():
    rows = predictions([("a", 0, 0.1), ("b", 0, 0.4), ("c", 2, 0.3), ("d", 3, 0.8), ("e", 4, 0.9), ("f", 2, 0.6)])
    both = pd.concat([rows, rows.assign(task="0 vs 3+4", p=1 - rows["p"])], ignore_index=True)
    scores = score_films(both, replicates=100, seed=0).set_index(["films_of", "learnt"])["auc"]
    assert scores.to_dict() == {
        ("0 vs 2", "0 vs 2"): 0.75,
        ("0 vs 2", "0 vs 3+4"): 0.25,
        ("0 vs 3+4", "0 vs 2"): 1.0,
        ("0 vs 3+4", "0 vs 3+4"): 0.0,
    }
