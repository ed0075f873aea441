"""What a grade can be told by: parameters, joint space, features; on cohorts whose answer is made."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binom

from pssf.core.processes.execution import Execution
from pssf.data.code_hash import compute_code_hashes
from pssf.study import DesignedManifests, StudySettings
from pssf.study.design.study_tables import load_study_tables, resolve_sampling_laws
from pssf.study.learn import incremental_value
from pssf.study.learn.each_split import CODE_PACKAGES
from pssf.study.learn.subject_split import split_subjects
from pssf.study.measurement import StudyContext
from pssf.study.simulator_analyses import run_simulator_analyses
from pssf.study.statistics.analyses import incremental_value_scores as tables

NAMES = ["firstorder_a", "glcm_a", "glcm_b"]
SETTINGS = StudySettings(repeats=10, selections=("l1",), models=("lr",))
RUN = StudyContext(len, (), SETTINGS, Path("unused"), Execution(), load_study_tables())


def cohort(seed: int, *, texture: float, subjects: int = 120, narrowed: float = 0.8) -> pd.DataFrame:
    """Known of knees of grades 0 and 2: the joint space follows the grade, and a texture does beside it."""
    rng = np.random.default_rng(seed)
    grade = 2 * (rng.permutation(subjects) % 2)
    narrow = 4.5 - narrowed * (grade == 2) + 0.5 * rng.normal(size=subjects)
    parameters = pd.DataFrame({"knee": range(subjects), "subject": range(subjects), "grade": grade})
    parameters = parameters.assign(nominal_jsw_medial_mm=narrow, nominal_jsw_lateral_mm=5.0 + rng.normal(size=subjects))
    usable = parameters[["knee", "subject", "grade"]].assign(protocol="reference", firstorder_a=narrow**2)
    usable["glcm_a"] = texture * (grade == 2) + rng.normal(size=subjects)
    usable["glcm_b"] = rng.normal(size=subjects)
    return incremental_value.build_predictor_table(usable, NAMES, parameters, SETTINGS)


def climbed(known: pd.DataFrame, **more) -> pd.DataFrame:
    return incremental_value.evaluate_predictor_sets(known, NAMES, SETTINGS, Execution(), **more)


def asked(manifest: pd.DataFrame, usable: pd.DataFrame):
    importance = pd.DataFrame(columns=["selection", "feature", "share"])
    return run_simulator_analyses(
        RUN, manifest, usable, NAMES, {"importance": importance}, DesignedManifests(), resolve_sampling_laws(manifest)
    )


@pytest.fixture(scope="module")
def splits() -> pd.DataFrame:
    return climbed(cohort(0, texture=2.0, narrowed=0.3, subjects=240))


def test_texture_that_knows_what_the_space_does_not_adds_to_it(splits):
    asked = tables.compare_predictor_sets(splits).set_index("question")["answer"]
    assert asked["does texture add to measured JSW?"] == "yes"
    assert asked["do features add to measured JSW?"] == "yes"


def test_too_few_tested_of_the_rarer_grade_answer_no_question(splits):
    assert set(tables.compare_predictor_sets(splits.assign(test_rarest=2))["answer"]) == {"not decidable"}


def test_texture_of_chance_adds_nothing():
    asked = tables.compare_predictor_sets(climbed(cohort(1, texture=0.0))).set_index("question")
    assert asked.loc["does texture add to measured JSW?", "answer"] != "yes"
    assert abs(asked.loc["does texture add to measured JSW?", "difference"]) < 0.05


def test_a_rung_has_the_interval_of_its_splits_and_a_ratio_of_the_subjects_it_learns_from(splits):
    rows = tables.summarise_predictor_sets(splits).set_index("rung")
    assert list(rows.index) == list(incremental_value.PREDICTOR_SETS)
    part = splits[splits["rung"] == "jsw"]
    assert rows.loc["jsw", "auc"] == pytest.approx(part["auc"].mean())
    assert tables.average_test_train_ratio(part) == pytest.approx(
        rows.loc["jsw", "test_subjects"] / rows.loc["jsw", "trained"]
    )
    assert (rows["low"] < rows["auc"]).all()
    assert (rows["auc"] < rows["high"]).all()


def test_a_reading_errs_as_its_source_says_and_is_the_knees_own():
    known = cohort(2, texture=1.0, subjects=2000)
    read, true = (known[[f"{kind}_medial_mm", f"{kind}_lateral_mm"]] for kind in ("measured", "true"))
    errors = read - true.to_numpy()
    assert_allclose(errors.std(), incremental_value.JSW_MEASUREMENT_SD_MM, rtol=0.05)
    assert abs(errors.corr().iloc[0, 1]) < 0.1
    usable = known[["knee", "subject", "grade", *NAMES]].assign(protocol="reference")
    parameters = known[["knee", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]].assign(subject=known["subject"])
    fewer = incremental_value.build_predictor_table(usable.iloc[5:], NAMES, parameters, SETTINGS)
    assert_allclose(fewer["measured_medial_mm"], known["measured_medial_mm"].iloc[5:])


def test_features_are_selected_and_a_space_beside_them_stays(splits):
    known = cohort(0, texture=2.0)
    columns = ["measured_least_mm", *NAMES]
    prepare = incremental_value.build_feature_pipeline("l1", rho=0.9, max_features=1, seed=0)
    step = incremental_value.SelectWithForced(prepare, ("measured_least_mm",)).fit(known[columns], known["grade"])
    assert step.kept_ == ["measured_least_mm", "glcm_a"]
    assert list(step.transform(known[columns]).columns) == step.kept_


def test_a_smaller_share_of_subjects_is_part_of_a_larger_one_and_the_tested_stay():
    known = cohort(0, texture=1.0)
    split = split_subjects(known["subject"], known["grade"], seed=0, repeat=3)
    small, large, whole = (
        incremental_value.subsample_subjects(split, known, incremental_value.SplitJob(3, share), 0)
        for share in (0.3, 0.6, 1.0)
    )
    for one, two, all_of in zip(small, large, whole, strict=True):
        assert set(one) < set(two) < set(all_of)
    assert len(small[0]) == pytest.approx(0.3 * len(whole[0]), abs=1)


def test_of_several_shares_the_growth_is_that_of_a_split_in_the_subjects_learnt_from(monkeypatch):
    monkeypatch.setattr(
        incremental_value,
        "evaluate_predictor_sets_split",
        lambda job, **shared: [{"seconds": 3.0 * job.training_fraction**1.4}],
    )
    known, execution = cohort(0, texture=1.0, subjects=24), Execution()
    for stage, shares in (("ladder", (1.0,)), ("learning curves", (0.2, 0.4, 0.8))):
        incremental_value.evaluate_predictor_sets(
            known, NAMES, SETTINGS, execution, training_fractions=shares, stage=stage
        )
    assert execution.timer.stages["learning curves"].time_exponent == pytest.approx(1.4)
    assert execution.timer.stages["ladder"].time_exponent is None


def test_what_was_learnt_says_how_long_its_split_took():
    known = cohort(0, texture=1.0, subjects=60)
    shared = {
        "known": known,
        "rungs": incremental_value.find_predictor_sets(known, NAMES),
        "settings": SETTINGS,
        "code": compute_code_hashes(CODE_PACKAGES),
    }
    rows = incremental_value.evaluate_predictor_sets_split(incremental_value.SplitJob(0, 0.5), **shared)
    (seconds,) = {row["seconds"] for row in rows}
    assert 0 < seconds < 60
    assert "seconds" not in climbed(known)


def test_without_joint_spaces_only_features_are_asked():
    known = cohort(0, texture=2.0)[["knee", "subject", "grade", *NAMES]]
    assert list(incremental_value.find_predictor_sets(known, NAMES)) == ["radiomics"]
    usable = known.assign(protocol="reference")
    assert not asked(known.drop(columns=NAMES), usable).sections


def test_the_report_shows_every_question_with_its_picture():
    known = cohort(0, texture=1.0)
    manifest = known[["knee", "subject", "grade", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]]
    answers = asked(manifest, known[["knee", "subject", "grade", *NAMES]].assign(protocol="reference"))
    assert set(answers.tables) == {"ladder", "ladder_differences", "learning", "power"}
    assert len(answers.sections[0].table) == len(tables.QUESTIONS)
    for section in answers.sections:
        assert section.pictures[0].png.startswith(b"\x89PNG")


@pytest.mark.parametrize("rare", [1, 2])
def test_a_grade_of_one_or_two_subjects_is_left_out_and_stops_nothing(rare):
    known = cohort(0, texture=1.0)
    asked_of = known[["knee", "subject", "grade", *NAMES]].assign(protocol="reference")
    manifest = known[["knee", "subject", "grade", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]]
    whole = asked(manifest, asked_of).tables["ladder"]
    few = asked_of["subject"].isin(known.loc[known["grade"] == 2, "subject"].iloc[:rare])
    grades = np.where(few, 1, asked_of["grade"])
    answers = asked(manifest.assign(grade=grades), asked_of.assign(grade=grades))
    assert set(answers.tables["ladder"]["grades"]) == set(whole["grades"]) == {"0 vs 2"}


def test_the_best_possible_is_the_better_fit_of_all_parameters():
    drawn = pd.DataFrame(
        {
            "grades": ["0 vs 1"] * 3,
            "known": ["JSW", "all parameters", "all parameters"],
            "how": ["logistic", "logistic", "boosted trees"],
            "knees": 10,
            "auc": [0.99, 0.8, 0.9],
            "low": 0.0,
            "high": 1.0,
        }
    )
    assert tables.select_best_possible(drawn)["auc"].tolist() == [0.9]


@pytest.mark.slow
def test_no_question_has_an_answer_from_random_labels():
    wrong: dict[str, int] = dict.fromkeys(tables.QUESTIONS, 0)
    for seed in range(20):
        asked = tables.compare_predictor_sets(climbed(cohort(100 + seed, texture=0.0, narrowed=0.0)))
        for row in asked.to_dict("records"):
            wrong[row["question"]] += row["answer"] != tables.UNDECIDED
    assert max(wrong.values()) <= binom.ppf(0.999, 20, 0.05), wrong
