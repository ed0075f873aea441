"""Check the study on extreme cohorts: few subjects, missing grades, constant features and missing values."""

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pssf.core.checks import InputError
from pssf.core.processes.execution import Execution
from pssf.study import StudySettings
from pssf.study.design.classification_tasks import TASKS, class_names, find_tasks
from pssf.study.design.study_tables import load_study_tables
from pssf.study.learn.models.final_models import refit_models
from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.subject_split import split_subjects
from pssf.study.predictions import SplitOutcome, concatenate_tables, find_class_indices
from pssf.study.statistics.features.feature_importance import sum_by_family
from pssf.study.statistics.result_tables import build_feature_tables, build_model_tables
from pssf.study.study_data import StudyContext, StudyData

PROTOCOLS = ("reference", "other")
NAMES = ["glcm_a", "glcm_b", "gldm_c", "ngtdm_d"]
LIGHT = StudySettings(models=("lr",), selections=("l1",), repeats=2, replicates=100)
ALL = StudySettings(models=("lr", "rf", "xgb"), selections=("l1", "mrmr"), repeats=1, replicates=100)


def make_feature_table(per_grade: int, *, noise: float = 0.5, seed: int = 0) -> pd.DataFrame:
    """Return features of subjects with grades 0, 1 and 2 under two protocols; `glcm_a` rises with grade."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(3 * per_grade):
        own = rng.normal(size=4) * noise
        own[0] += subject % 3
        for protocol in PROTOCOLS:
            row = {"radiograph": f"{subject}_{protocol}", "knee": subject, "subject": subject, "grade": subject % 3}
            values = dict(zip(NAMES, own + 0.1 * noise * rng.normal(size=4), strict=True))
            rows.append(row | {"protocol": protocol, "nominal_jsw_medial_mm": 5.0 - subject % 3, **values})
    return pd.DataFrame(rows)


def run_splits(
    cohort: pd.DataFrame, settings: StudySettings = ALL
) -> tuple[list[SplitOutcome], dict[str, pd.DataFrame]]:
    """Evaluate all splits of a cohort and build the model tables."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcomes = [evaluate_split(r, table=cohort, names=NAMES, settings=settings) for r in range(settings.repeats)]
        return outcomes, build_model_tables(outcomes, settings)


def test_three_subjects_per_grade_are_accepted_and_two_are_rejected():
    _, tables = run_splits(make_feature_table(3), dataclasses.replace(ALL, selections=("l1",), repeats=2))
    scores = tables["scores"]
    assert (scores["test_subjects"] == scores["task"].map({"0 vs 2": 2, "0/1/2": 3})).all()
    assert (scores["auc_low"] <= scores["auc"]).all()
    assert (scores["auc"] <= scores["auc_high"]).all()
    with pytest.raises(InputError, match=r"must have at least 3 subjects .*got 2"):
        evaluate_split(0, table=make_feature_table(2), names=NAMES, settings=LIGHT)


def test_the_error_for_a_single_subject_of_a_grade_names_the_grade():
    with pytest.raises(InputError, match=r"grade 0 must have at least 3 subjects .*got 1"):
        evaluate_split(0, table=make_feature_table(1), names=NAMES, settings=LIGHT)


def test_a_grade_missing_from_a_test_set_gives_nan_only_for_that_set():
    cohort = make_feature_table(6)
    split = split_subjects(cohort["subject"], cohort["grade"], seed=0)
    missing = cohort["subject"].isin(split.test) & (cohort["grade"] == 2) & (cohort["protocol"] == "other")
    _, tables = run_splits(cohort[~missing], dataclasses.replace(LIGHT, repeats=1))
    scores = tables["scores"].set_index(["task", "scenario", "tested_on", "model"])
    cross = scores.loc[("0 vs 2", "cross", "other", "lr")]
    assert np.isnan(cross["auc"])
    assert np.isnan(cross["auc_low"])
    assert cross["splits"] == 0
    assert np.isfinite(scores.loc[("0 vs 2", "within", "reference", "lr"), "auc"])
    difference = tables["differences"].query("comparison == 'cross minus within' and task == '0 vs 2'")
    assert len(difference) == 3
    assert difference[["difference", "p", "p_holm"]].isna().all(axis=None)


def test_a_protocol_lacking_a_grade_in_training_is_omitted():
    cohort = make_feature_table(6)
    split = split_subjects(cohort["subject"], cohort["grade"], seed=0)
    missing = cohort["subject"].isin(split.training) & (cohort["grade"] == 2) & (cohort["protocol"] == "reference")
    outcomes, tables = run_splits(cohort[~missing], dataclasses.replace(LIGHT, repeats=1))
    found = outcomes[0].predictions
    assert set(found["trained_on"]) == {"all", "mixed"}
    assert outcomes[0].selection_candidates.columns.tolist() == ["task", "trained_on", "selection", "repeat", "feature"]
    for name in ("calibration", "calibration_curve", "importance", "permutation"):
        assert tables[name].empty, name
    merged = tables["importance"].merge(tables["permutation"], on=["model", "selection", "feature"], how="left")
    assert sum_by_family(merged).join(sum_by_family(merged, "drop").add_suffix(" drop")).shape == (7, 0)


@pytest.mark.parametrize("selection", ["l1", pytest.param("mrmr", marks=pytest.mark.slow)])
def test_constant_features_give_chance_performance_in_every_scenario(selection):
    settings = StudySettings(models=("lr", "rf", "xgb"), selections=(selection,), repeats=2, replicates=100)
    cohort = make_feature_table(5).assign(**dict.fromkeys(NAMES, 4.0))
    outcomes, tables = run_splits(cohort, settings)
    models = tables["scores"][tables["scores"]["selection"] != "none"]
    assert (models["auc"] == 0.5).all()
    assert (models["auc_low"] == 0.5).all()
    assert set(models["scenario"]) == {"within", "cross", "cross_harmonised", "multi", "mixed"}  # no feature is stable
    assert [outcome.stable_feature_count for outcome in outcomes] == [0, 0]
    assert tables["calibration"].query("selection != 'none'")["slope"].fillna(0).abs().max() < 1e-6
    assert (tables["permutation"]["drop"] == 0).all()


def test_perfectly_separable_grades_give_an_auc_of_one_without_width():
    _, tables = run_splits(make_feature_table(8, noise=0.01), LIGHT)
    scores = tables["scores"]
    models = scores[(scores["selection"] != "none") & (scores["task"] == "0 vs 2")]
    assert (models[["auc", "auc_low", "auc_high"]] == 1.0).all(axis=None)
    two = tables["differences"].query("task == '0 vs 2' and metric == 'auc'")
    assert (two["difference"] == 0).all()
    assert (two["p_holm"] == 1).all()


def test_missing_test_values_are_imputed_but_training_values_are_not():
    cohort = make_feature_table(6)
    split = split_subjects(cohort["subject"], cohort["grade"], seed=0)
    for part, used in ((split.test, True), (split.training, False)):
        incomplete = cohort.copy()
        incomplete.loc[incomplete["subject"] == part[0], "glcm_a"] = np.nan
        outcome = evaluate_split(0, table=incomplete, names=NAMES, settings=LIGHT)
        assert outcome.predictions["p0"].notna().all()
        of_reference = outcome.importances[outcome.importances["trained_on"] == "reference"]
        assert ("glcm_a" in set(of_reference["feature"])) == used


def test_a_knee_whose_joint_is_not_located_is_counted_and_excluded():
    cohort = make_feature_table(6).assign(status="found", score=0.9)
    cohort = cohort.assign(error_px=1.0, error_mm=0.1, error_row_mm=0.1, error_col_mm=0.1)
    missing = cohort["knee"] == 5
    cohort.loc[missing, "status"] = "low score"
    cohort.loc[missing, NAMES] = np.nan
    run = StudyContext(len, (), LIGHT, Path("unused"), Execution(), load_study_tables())
    none = cohort.head(0)
    data = StudyData(run=run, manifest=cohort, parameters=none, located=cohort, repeated=none, names=NAMES)
    tables = build_feature_tables(data)
    assert tables["localisation"].iloc[-1]["rejected"] == 2
    assert (tables["reliability"]["knees"] == 17).all()
    found = evaluate_split(0, table=cohort[~missing], names=NAMES, settings=LIGHT).predictions
    assert 5 not in set(found["knee"])


def test_tasks_depend_on_the_grades_of_the_cohort():
    assert list(find_tasks([0, 1, 2])) == ["0 vs 2", "0/1/2"]
    assert list(find_tasks([0, 4])) == ["0 vs 3+4"]
    assert list(find_tasks(range(5))) == list(TASKS)
    assert list(find_tasks(range(4))) == ["0 vs 2", "0/1/2", "0 vs 3+4"]
    assert TASKS["0/1/2/3/4"] == tuple((grade,) for grade in range(5))
    assert find_class_indices(np.array([4, 0, 3]), TASKS["0 vs 3+4"]).tolist() == [1, 0, 1]
    assert class_names("0 vs 3+4") == ("normal", "moderate OA or severe OA")


def test_grades_3_and_4_form_one_class_and_do_not_affect_other_tasks():
    cohort = make_feature_table(6)
    worse = cohort[cohort["grade"] > 0].copy()
    for name in ("subject", "knee"):
        worse[name] += 100
    worse["radiograph"] = "worse_" + worse["radiograph"]
    worse["grade"] += 2
    worse["glcm_a"] += 3.0
    outcomes, tables = run_splits(pd.concat([cohort, worse], ignore_index=True), LIGHT)
    found = concatenate_tables([outcome.predictions for outcome in outcomes])
    assert set(found["task"]) == set(TASKS)
    advanced = found[found["task"] == "0 vs 3+4"].drop_duplicates("radiograph")
    assert ((advanced["subject"] >= 100) == (advanced["truth"] == 1)).all()
    scores = tables["scores"].query("task == '0 vs 3+4' and scenario == 'within' and model == 'lr'")
    assert (scores["auc"] > 0.9).all()
    assert set(tables["confusion"].query("task == '0 vs 3+4'")["true_grade"]) == {0, 3}
    _, without = run_splits(cohort, LIGHT)
    assert set(without["scores"]["task"]) == {"0 vs 2", "0/1/2"}
    models = {one.name: one for one in refit_models(cohort, NAMES, LIGHT, {"all": PROTOCOLS})}
    assert {one.task for one in models.values()} == {"0 vs 2", "0/1/2"}
    both = pd.concat([cohort, worse], ignore_index=True)
    advanced = {one.name: one for one in refit_models(both, NAMES, LIGHT, {"all": PROTOCOLS})}["lr_l1_0v34_all"]
    assert advanced.grades == (0, 3)
