"""Models that are kept: fitted once more, to all subjects."""

import numpy as np
from made_up import SHAKY_NAMES, measured_cohort, settings_of

from pssf.study.learn.models.classifiers import fit_with_parameters, tune_classifier
from pssf.study.learn.models.feature_selection import build_feature_pipeline
from pssf.study.learn.models.final_models import refit_models
from pssf.study.learn.subject_split import split_subjects

SETS = {"a": ("a",), "all": ("a", "b")}


def test_every_task_selection_and_model_is_fitted_to_all_subjects_of_its_protocols():
    table = measured_cohort()
    settings = settings_of(selections=("l1", "mrmr"), models=("lr", "rf"))
    kept = {one.name: one for one in refit_models(table, SHAKY_NAMES, settings, SETS)}
    assert set(kept) == {
        f"{m}_{s}_{t}_{on}" for m in ("lr", "rf") for s in ("l1", "mrmr") for t in ("0v2", "012") for on in SETS
    }
    sizes = {name: (one.subjects, one.radiographs) for name, one in kept.items() if name.startswith("lr_l1")}
    assert sizes == {
        "lr_l1_0v2_a": (24, 24), "lr_l1_012_a": (36, 36), "lr_l1_0v2_all": (24, 48), "lr_l1_012_all": (36, 72)
    }  # fmt: skip


def test_a_model_has_the_first_splits_parameters_and_knows_every_subject():
    table = measured_cohort()
    one = next(refit_models(table, SHAKY_NAMES, settings_of(), {"a": ("a",)}))
    rows = table[(table["protocol"] == "a") & table["grade"].isin((0, 2))]
    scaled = one.fitted.pipeline.named_steps["scale"]
    names = one.fitted.pipeline.named_steps["drop"].kept_
    np.testing.assert_allclose(scaled.mean_, rows[names].mean().to_numpy())
    lost = rows.index[0]
    other = next(refit_models(table.drop(index=lost), SHAKY_NAMES, settings_of(), {"a": ("a",)}))
    assert not np.array_equal(other.fitted.pipeline.named_steps["scale"].mean_, scaled.mean_)


def test_parameters_are_chosen_on_the_first_splits_validation_subjects_and_on_no_other(monkeypatch):
    table, chosen = measured_cohort(), []

    def seen(preparation, model, training, validation, **how):
        chosen.append([set(table.loc[part[0].index, "subject"]) for part in (training, validation)])
        return tune_classifier(preparation, model, training, validation, **how)

    monkeypatch.setattr("pssf.study.learn.models.final_models.tune_classifier", seen)
    list(refit_models(table, SHAKY_NAMES, settings_of(), SETS))
    split = split_subjects(table["subject"], table["grade"], seed=0)
    asked = {grades: set(table.loc[table["grade"].isin(grades), "subject"]) for grades in ((0, 2), (0, 1, 2))}
    of_tasks = [[set(of) & whose for of in (split.training, split.validation)] for whose in asked.values()]
    assert chosen == of_tasks * len(SETS)


def test_a_grade_that_the_first_split_has_not_under_some_protocol_leaves_its_models_out():
    table = measured_cohort()
    lost = (table["grade"] == 2) & (table["protocol"] == "a")
    assert not list(refit_models(table[~lost], SHAKY_NAMES, settings_of(), {"a": ("a",)}))


def test_refitting_to_the_same_rows_gives_the_model_that_was_tuned():
    table = measured_cohort()
    X, y = table[SHAKY_NAMES], (table["grade"] == 2).astype(int).to_numpy()
    prepared = build_feature_pipeline("l1", rho=0.9, max_features=5, seed=0).fit(X, y)
    for model in ("lr", "rf", "xgb", "chance"):
        tuned = tune_classifier(prepared, model, (X, y), (X, y), seed=0)
        again = fit_with_parameters(prepared, model, tuned.parameters, (X, y), seed=0)
        np.testing.assert_array_equal(again.pipeline.predict_proba(X), tuned.pipeline.predict_proba(X))
