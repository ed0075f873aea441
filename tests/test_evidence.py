"""Cohorts at the edge: few subjects, missing grades, nothing to learn, everything known, holes."""

import dataclasses
import warnings

import numpy as np
import pandas as pd
import pytest

from pssf.core.checks import InputError
from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.study import StudySettings
from pssf.study.design.classification_tasks import TASKS, class_names, find_tasks
from pssf.study.learn.models.final_models import refit_models
from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.subject_split import split_subjects
from pssf.study.predictions import SplitOutcome, concatenate_tables, find_class_indices
from pssf.study.statistics.features.feature_importance import sum_by_family
from pssf.study.statistics.result_tables import build_feature_tables, build_model_tables

PROTOCOLS = ("reference", "other")
NAMES = ["glcm_a", "glcm_b", "gldm_c", "ngtdm_d"]
LIGHT = StudySettings(models=("lr",), selections=("l1",), repeats=2, replicates=100)
ALL = StudySettings(models=("lr", "rf", "xgb"), selections=("l1", "mrmr"), repeats=1, replicates=100)


def table(per_grade: int, *, noise: float = 0.5, seed: int = 0) -> pd.DataFrame:
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


def study(cohort: pd.DataFrame, settings: StudySettings = ALL) -> tuple[list[SplitOutcome], dict[str, pd.DataFrame]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcomes = [evaluate_split(r, table=cohort, names=NAMES, settings=settings) for r in range(settings.repeats)]
        return outcomes, build_model_tables(outcomes, settings)


def test_three_subjects_of_a_grade_are_enough_and_two_are_refused():
    _, tables = study(table(3), dataclasses.replace(ALL, repeats=2))
    scores = tables["scores"]
    assert (scores["test_subjects"] == scores["task"].map({"0 vs 2": 2, "0/1/2": 3})).all()
    assert (scores["auc_low"] <= scores["auc"]).all()
    assert (scores["auc"] <= scores["auc_high"]).all()
    with pytest.raises(InputError, match=r"must have at least 3 subjects .*got 2"):
        evaluate_split(0, table=table(2), names=NAMES, settings=LIGHT)


def test_three_subjects_in_all_are_refused_by_name():
    with pytest.raises(InputError, match=r"grade 0 must have at least 3 subjects .*got 1"):
        evaluate_split(0, table=table(1), names=NAMES, settings=LIGHT)


def test_a_grade_that_is_missing_from_a_test_part_gives_no_measure_there_and_the_others_stand():
    cohort = table(6)
    split = split_subjects(cohort["subject"], cohort["grade"], seed=0)
    lost = cohort["subject"].isin(split.test) & (cohort["grade"] == 2) & (cohort["protocol"] == "other")
    _, tables = study(cohort[~lost], dataclasses.replace(LIGHT, repeats=1))
    scores = tables["scores"].set_index(["task", "scenario", "tested_on", "model"])
    cross = scores.loc[("0 vs 2", "cross", "other", "lr")]
    assert np.isnan(cross["auc"])
    assert np.isnan(cross["auc_low"])
    assert cross["splits"] == 0
    assert np.isfinite(scores.loc[("0 vs 2", "within", "reference", "lr"), "auc"])
    difference = tables["differences"].query("comparison == 'cross minus within' and task == '0 vs 2'")
    assert len(difference) == 3
    assert difference[["difference", "p", "p_holm"]].isna().all(axis=None)


def test_a_grade_that_is_missing_from_training_under_one_protocol_leaves_its_arms_out():
    cohort = table(6)
    split = split_subjects(cohort["subject"], cohort["grade"], seed=0)
    lost = cohort["subject"].isin(split.training) & (cohort["grade"] == 2) & (cohort["protocol"] == "reference")
    outcomes, tables = study(cohort[~lost], dataclasses.replace(LIGHT, repeats=1))
    found = outcomes[0].predictions
    assert set(found["trained_on"]) == {"all", "mixed"}
    assert outcomes[0].selection_candidates.columns.tolist() == ["task", "trained_on", "selection", "repeat", "feature"]
    for name in ("calibration", "calibration_curve", "importance", "permutation"):
        assert tables[name].empty, name
    shown = tables["importance"].merge(tables["permutation"], on=["model", "selection", "feature"], how="left")
    assert sum_by_family(shown).join(sum_by_family(shown, "drop").add_suffix(" drop")).shape == (7, 0)


@pytest.mark.parametrize("selection", ["l1", "mrmr"])
def test_features_that_are_all_constant_give_chance_in_every_scenario(selection):
    settings = StudySettings(models=("lr", "rf", "xgb"), selections=(selection,), repeats=2, replicates=100)
    cohort = table(5).assign(**dict.fromkeys(NAMES, 4.0))
    outcomes, tables = study(cohort, settings)
    models = tables["scores"][tables["scores"]["selection"] != "none"]
    assert (models["auc"] == 0.5).all()
    assert (models["auc_low"] == 0.5).all()
    assert set(models["scenario"]) == {"within", "cross", "cross_harmonised", "multi", "mixed"}  # no feature is stable
    assert [outcome.stable_feature_count for outcome in outcomes] == [0, 0]
    assert tables["calibration"].query("selection != 'none'")["slope"].fillna(0).abs().max() < 1e-6
    assert (tables["permutation"]["drop"] == 0).all()


def test_grades_that_are_perfectly_apart_are_told_without_error_or_width():
    _, tables = study(table(8, noise=0.01), LIGHT)
    scores = tables["scores"]
    models = scores[(scores["selection"] != "none") & (scores["task"] == "0 vs 2")]
    assert (models[["auc", "auc_low", "auc_high"]] == 1.0).all(axis=None)
    two = tables["differences"].query("task == '0 vs 2' and metric == 'auc'")
    assert (two["difference"] == 0).all()
    assert (two["p_holm"] == 1).all()


def test_a_hole_in_a_test_radiograph_is_filled_and_one_in_training_costs_the_feature():
    cohort = table(6)
    split = split_subjects(cohort["subject"], cohort["grade"], seed=0)
    for part, kept in ((split.test, True), (split.training, False)):
        holed = cohort.copy()
        holed.loc[holed["subject"] == part[0], "glcm_a"] = np.nan
        outcome = evaluate_split(0, table=holed, names=NAMES, settings=LIGHT)
        assert outcome.predictions["p0"].notna().all()
        of_reference = outcome.importances[outcome.importances["trained_on"] == "reference"]
        assert ("glcm_a" in set(of_reference["feature"])) == kept


def test_a_knee_whose_joint_is_not_found_is_left_out_of_scores_and_reliability_and_counted():
    cohort = table(6).assign(status="found", score=0.9)
    cohort = cohort.assign(error_px=1.0, error_mm=0.1, error_row_mm=0.1, error_col_mm=0.1)
    lost = cohort["knee"] == 5
    cohort.loc[lost, "status"] = "low score"
    cohort.loc[lost, NAMES] = np.nan
    tables = build_feature_tables(cohort, cohort.head(0), NAMES, load_ibsi_tags(), LIGHT)
    assert tables["localisation"].iloc[-1]["refused"] == 2
    assert (tables["reliability"]["knees"] == 17).all()
    found = evaluate_split(0, table=cohort[~lost], names=NAMES, settings=LIGHT).predictions
    assert 5 not in set(found["knee"])


def test_tasks_are_those_whose_grades_a_cohort_has():
    assert list(find_tasks([0, 1, 2])) == ["0 vs 2", "0/1/2"]
    assert list(find_tasks([0, 4])) == ["0 vs 3+4"]
    assert list(find_tasks(range(5))) == list(TASKS)
    assert list(find_tasks(range(4))) == ["0 vs 2", "0/1/2", "0 vs 3+4"]
    assert TASKS["0/1/2/3/4"] == tuple((grade,) for grade in range(5))
    assert find_class_indices(np.array([4, 0, 3]), TASKS["0 vs 3+4"]).tolist() == [1, 0, 1]
    assert class_names("0 vs 3+4") == ("normal", "moderate OA or severe OA")


def test_grades_3_and_4_are_told_from_0_as_one_class_and_leave_the_other_tasks_alone():
    cohort = table(6)
    worse = cohort[cohort["grade"] > 0].copy()
    for name in ("subject", "knee"):
        worse[name] += 100
    worse["radiograph"] = "worse_" + worse["radiograph"]
    worse["grade"] += 2
    worse["glcm_a"] += 3.0
    outcomes, tables = study(pd.concat([cohort, worse], ignore_index=True), LIGHT)
    found = concatenate_tables([outcome.predictions for outcome in outcomes])
    assert set(found["task"]) == set(TASKS)
    advanced = found[found["task"] == "0 vs 3+4"].drop_duplicates("radiograph")
    assert ((advanced["subject"] >= 100) == (advanced["truth"] == 1)).all()
    scores = tables["scores"].query("task == '0 vs 3+4' and scenario == 'within' and model == 'lr'")
    assert (scores["auc"] > 0.9).all()
    assert set(tables["confusion"].query("task == '0 vs 3+4'")["true_grade"]) == {0, 3}
    _, without = study(cohort, LIGHT)
    assert set(without["scores"]["task"]) == {"0 vs 2", "0/1/2"}
    kept = {one.name: one for one in refit_models(cohort, NAMES, LIGHT, {"all": PROTOCOLS})}
    assert {one.task for one in kept.values()} == {"0 vs 2", "0/1/2"}
    both = pd.concat([cohort, worse], ignore_index=True)
    advanced = {one.name: one for one in refit_models(both, NAMES, LIGHT, {"all": PROTOCOLS})}["lr_l1_0v34_all"]
    assert advanced.grades == (0, 3)
