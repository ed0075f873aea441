"""Check the final models, which are refitted to all subjects."""

import numpy as np
from synthetic_features import UNSTABLE_NAMES, make_measured_cohort, make_settings

from pssf.study.learn.models.classifiers import fit_with_parameters, tune_classifier
from pssf.study.learn.models.feature_selection import build_feature_pipeline
from pssf.study.learn.models.final_models import refit_models
from pssf.study.learn.subject_split import split_subjects

SETS = {"a": ("a",), "all": ("a", "b")}


def test_every_model_is_refitted_to_all_subjects_of_its_protocols():
    table = make_measured_cohort()
    settings = make_settings(selections=("l1", "mrmr"), models=("lr", "rf"))
    final = {one.name: one for one in refit_models(table, UNSTABLE_NAMES, settings, SETS)}
    assert set(final) == {
        f"{m}_{s}_{t}_{on}" for m in ("lr", "rf") for s in ("l1", "mrmr") for t in ("0v2", "012") for on in SETS
    }
    sizes = {name: (one.subjects, one.radiographs) for name, one in final.items() if name.startswith("lr_l1")}
    assert sizes == {
        "lr_l1_0v2_a": (24, 24), "lr_l1_012_a": (36, 36), "lr_l1_0v2_all": (24, 48), "lr_l1_012_all": (36, 72)
    }  # fmt: skip


def test_a_final_model_is_trained_on_every_subject():
    table = make_measured_cohort()
    one = next(refit_models(table, UNSTABLE_NAMES, make_settings(), {"a": ("a",)}))
    rows = table[(table["protocol"] == "a") & table["grade"].isin((0, 2))]
    scaled = one.fitted.pipeline.named_steps["scale"]
    names = one.fitted.pipeline.named_steps["drop"].kept_
    np.testing.assert_allclose(scaled.mean_, rows[names].mean().to_numpy())
    dropped = rows.index[0]
    other = next(refit_models(table.drop(index=dropped), UNSTABLE_NAMES, make_settings(), {"a": ("a",)}))
    assert not np.array_equal(other.fitted.pipeline.named_steps["scale"].mean_, scaled.mean_)


def test_parameters_are_tuned_on_the_first_split(monkeypatch):
    table, tuned_on = make_measured_cohort(), []

    def record_subjects(preparation, model, training, validation, **options):
        tuned_on.append([set(table.loc[part[0].index, "subject"]) for part in (training, validation)])
        return tune_classifier(preparation, model, training, validation, **options)

    monkeypatch.setattr("pssf.study.learn.models.final_models.tune_classifier", record_subjects)
    list(refit_models(table, UNSTABLE_NAMES, make_settings(), SETS))
    split = split_subjects(table["subject"], table["grade"], seed=0)
    subjects = {grades: set(table.loc[table["grade"].isin(grades), "subject"]) for grades in ((0, 2), (0, 1, 2))}
    expected = [[set(part) & selected for part in (split.training, split.validation)] for selected in subjects.values()]
    assert tuned_on == expected * len(SETS)


def test_no_model_is_refitted_if_the_first_split_lacks_a_grade():
    table = make_measured_cohort()
    dropped = (table["grade"] == 2) & (table["protocol"] == "a")
    assert not list(refit_models(table[~dropped], UNSTABLE_NAMES, make_settings(), {"a": ("a",)}))


def test_refitting_a_model_to_the_same_rows_gives_the_same_predictions():
    table = make_measured_cohort()
    X, y = table[UNSTABLE_NAMES], (table["grade"] == 2).astype(int).to_numpy()
    prepared = build_feature_pipeline("l1", rho=0.9, max_features=5, seed=0).fit(X, y)
    for model in ("lr", "rf", "xgb", "chance"):
        tuned = tune_classifier(prepared, model, (X, y), (X, y), seed=0)
        again = fit_with_parameters(prepared, model, tuned.parameters, (X, y), seed=0)
        np.testing.assert_array_equal(again.pipeline.predict_proba(X), tuned.pipeline.predict_proba(X))
