"""Check the incremental predictive value of parameters, JSW and features on synthetic cohorts with known answers."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binom

from pssf.core.processes.execution import Execution
from pssf.data.code_hash import compute_code_hashes
from pssf.study import StudySettings
from pssf.study.design.study_tables import load_study_tables, resolve_sampling_laws
from pssf.study.learn import incremental_value
from pssf.study.learn.each_split import CODE_PACKAGES
from pssf.study.learn.subject_split import split_subjects
from pssf.study.simulator_analyses import run_simulator_analyses
from pssf.study.statistics.analyses import incremental_value_scores as tables
from pssf.study.statistics.analyses.knee_parameters import extract_knee_parameters
from pssf.study.study_data import StudyContext, StudyData

NAMES = ["firstorder_a", "glcm_a", "glcm_b"]
SETTINGS = StudySettings(repeats=10, selections=("l1",), models=("lr",))


def make_predictors(seed: int, *, texture: float, subjects: int = 120, narrowed: float = 0.8) -> pd.DataFrame:
    """Make predictors for knees with grades 0 and 2; JSW and one texture feature depend on the grade."""
    rng = np.random.default_rng(seed)
    grade = 2 * (rng.permutation(subjects) % 2)
    narrow = 4.5 - narrowed * (grade == 2) + 0.5 * rng.normal(size=subjects)
    parameters = pd.DataFrame({"knee": range(subjects), "subject": range(subjects), "grade": grade})
    parameters = parameters.assign(nominal_jsw_medial_mm=narrow, nominal_jsw_lateral_mm=5.0 + rng.normal(size=subjects))
    usable = parameters[["knee", "subject", "grade"]].assign(protocol="reference", firstorder_a=narrow**2)
    usable["glcm_a"] = texture * (grade == 2) + rng.normal(size=subjects)
    usable["glcm_b"] = rng.normal(size=subjects)
    return incremental_value.build_predictor_table(usable, NAMES, parameters, SETTINGS)


def evaluate_sets(known: pd.DataFrame, **more) -> pd.DataFrame:
    return incremental_value.evaluate_predictor_sets(known, NAMES, SETTINGS, Execution(), **more)


def run_analyses(manifest: pd.DataFrame, usable: pd.DataFrame, repeats: int = SETTINGS.repeats):
    settings = dataclasses.replace(SETTINGS, repeats=repeats)
    importance = pd.DataFrame(columns=["selection", "feature", "importance"])
    study = StudyData(
        run=StudyContext(len, (), settings, Path("unused"), Execution(), load_study_tables()),
        manifest=manifest,
        parameters=extract_knee_parameters(manifest),
        located=usable.assign(status="found"),
        repeated=usable.head(0),
        names=NAMES,
        laws=resolve_sampling_laws(manifest),
        tables={"importance": importance},
    )
    return run_simulator_analyses(study)


@pytest.fixture(scope="module")
def splits() -> pd.DataFrame:
    return evaluate_sets(make_predictors(0, texture=2.0, narrowed=0.3, subjects=240))


def test_texture_with_independent_information_adds_to_jsw(splits):
    answers = tables.compare_predictor_sets(splits).set_index("question")["answer"]
    assert answers["does texture add to measured JSW?"] == "yes"
    assert answers["do features add to measured JSW?"] == "yes"


def test_too_few_test_subjects_of_a_grade_leave_questions_undecided(splits):
    assert set(tables.compare_predictor_sets(splits.assign(test_rarest=2))["answer"]) == {"not decidable"}


def test_random_texture_adds_no_information_to_jsw():
    answers = tables.compare_predictor_sets(evaluate_sets(make_predictors(1, texture=0.0))).set_index("question")
    assert answers.loc["does texture add to measured JSW?", "answer"] != "yes"
    assert abs(answers.loc["does texture add to measured JSW?", "difference"]) < 0.05


def test_each_predictor_set_has_the_mean_auc_and_interval_of_its_splits(splits):
    rows = tables.summarise_predictor_sets(splits).set_index("predictor_set")
    assert list(rows.index) == list(incremental_value.PREDICTOR_SETS)
    part = splits[splits["predictor_set"] == "jsw"]
    assert rows.loc["jsw", "auc"] == pytest.approx(part["auc"].mean())
    assert tables.average_test_train_ratio(part) == pytest.approx(
        rows.loc["jsw", "test_subjects"] / rows.loc["jsw", "training_subjects"]
    )
    assert (rows["low"] < rows["auc"]).all()
    assert (rows["auc"] < rows["high"]).all()


def test_jsw_measurement_error_has_the_published_sd():
    known = make_predictors(2, texture=1.0, subjects=2000)
    read, true = (known[[f"{kind}_medial_mm", f"{kind}_lateral_mm"]] for kind in ("measured", "true"))
    errors = read - true.to_numpy()
    assert_allclose(errors.std(), incremental_value.JSW_MEASUREMENT_SD_MM, rtol=0.05)
    assert abs(errors.corr().iloc[0, 1]) < 0.1
    usable = known[["knee", "subject", "grade", *NAMES]].assign(protocol="reference")
    parameters = known[["knee", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]].assign(subject=known["subject"])
    fewer = incremental_value.build_predictor_table(usable.iloc[5:], NAMES, parameters, SETTINGS)
    assert_allclose(fewer["measured_medial_mm"], known["measured_medial_mm"].iloc[5:])


def test_feature_selection_keeps_the_forced_joint_space(splits):
    known = make_predictors(0, texture=2.0)
    columns = ["measured_least_mm", *NAMES]
    prepare = incremental_value.build_feature_pipeline("l1", rho=0.9, max_features=1, seed=0)
    step = incremental_value.SelectWithForced(prepare, ("measured_least_mm",)).fit(known[columns], known["grade"])
    assert step.kept_ == ["measured_least_mm", "glcm_a"]
    assert list(step.transform(known[columns]).columns) == step.kept_


def test_a_smaller_training_fraction_is_a_subset_of_a_larger_one():
    known = make_predictors(0, texture=1.0)
    split = split_subjects(known["subject"], known["grade"], seed=0, repeat=3)
    small, large, whole = (
        incremental_value.subsample_subjects(split, known, incremental_value.SplitJob(3, fraction), 0)
        for fraction in (0.3, 0.6, 1.0)
    )
    for one, two, all_of in zip(small, large, whole, strict=True):
        assert set(one) < set(two) < set(all_of)
    assert len(small[0]) == pytest.approx(0.3 * len(whole[0]), abs=1)


def test_time_exponent_is_fitted_to_the_number_of_training_subjects(monkeypatch):
    monkeypatch.setattr(
        incremental_value,
        "evaluate_predictor_sets_split",
        lambda job, **shared: [{"seconds": 3.0 * job.training_fraction**1.4}],
    )
    known, execution = make_predictors(0, texture=1.0, subjects=24), Execution()
    for stage, fractions in (("incremental value", (1.0,)), ("learning curves", (0.2, 0.4, 0.8))):
        incremental_value.evaluate_predictor_sets(
            known, NAMES, SETTINGS, execution, training_fractions=fractions, stage=stage
        )
    assert execution.timer.stages["learning curves"].time_exponent == pytest.approx(1.4)
    assert execution.timer.stages["incremental value"].time_exponent is None


def test_predictor_sets_report_the_seconds_of_each_split():
    known = make_predictors(0, texture=1.0, subjects=30)
    shared = {
        "known": known,
        "predictor_sets": incremental_value.find_predictor_sets(known, NAMES),
        "settings": SETTINGS,
        "code": compute_code_hashes(CODE_PACKAGES),
    }
    rows = incremental_value.evaluate_predictor_sets_split(incremental_value.SplitJob(0, 0.5), **shared)
    (seconds,) = {row["seconds"] for row in rows}
    assert 0 < seconds < 60
    assert "seconds" not in evaluate_sets(known)


def test_without_joint_spaces_only_radiomics_is_evaluated():
    known = make_predictors(0, texture=2.0)[["knee", "subject", "grade", *NAMES]]
    assert list(incremental_value.find_predictor_sets(known, NAMES)) == ["radiomics"]
    usable = known.assign(protocol="reference")
    assert not run_analyses(known.drop(columns=NAMES), usable).sections


def test_the_report_shows_every_question_with_a_figure():
    known = make_predictors(0, texture=1.0)
    manifest = known[["knee", "subject", "grade", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]]
    answers = run_analyses(
        manifest, known[["knee", "subject", "grade", *NAMES]].assign(protocol="reference"), repeats=3
    )
    assert set(answers.tables) == {"incremental_value", "incremental_value_differences", "learning", "power"}
    assert len(answers.sections[0].table) == len(tables.QUESTIONS)
    for section in answers.sections:
        assert section.pictures[0].png.startswith(b"\x89PNG")


@pytest.mark.parametrize("rare", [1, 2])
def test_a_grade_with_one_or_two_subjects_is_excluded(rare):
    known = make_predictors(0, texture=1.0, subjects=60)
    usable = known[["knee", "subject", "grade", *NAMES]].assign(protocol="reference")
    manifest = known[["knee", "subject", "grade", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]]
    few = usable["subject"].isin(known.loc[known["grade"] == 2, "subject"].iloc[:rare])
    grades = np.where(few, 1, usable["grade"])
    answers = run_analyses(manifest.assign(grade=grades), usable.assign(grade=grades), repeats=3)
    assert set(answers.tables["incremental_value"]["grades"]) == {"0 vs 2"}


def test_the_best_possible_auc_is_that_of_the_better_parameter_model():
    fits = pd.DataFrame(
        {
            "grades": ["0 vs 1"] * 3,
            "parameters": ["JSW", "all parameters", "all parameters"],
            "method": ["logistic", "logistic", "boosted trees"],
            "knees": 10,
            "auc": [0.99, 0.8, 0.9],
            "low": 0.0,
            "high": 1.0,
        }
    )
    assert tables.select_best_possible(fits)["auc"].tolist() == [0.9]


@pytest.mark.slow
def test_random_labels_leave_every_question_undecided():
    wrong: dict[str, int] = dict.fromkeys(tables.QUESTIONS, 0)
    for seed in range(20):
        answers = tables.compare_predictor_sets(evaluate_sets(make_predictors(100 + seed, texture=0.0, narrowed=0.0)))
        for row in answers.to_dict("records"):
            wrong[row["question"]] += row["answer"] != tables.UNDECIDED
    assert max(wrong.values()) <= binom.ppf(0.999, 20, 0.05), wrong
