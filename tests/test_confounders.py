"""Check training with designed confounding, on cohorts in which a feature depends on the confounder."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from pssf.core.processes.execution import Execution
from pssf.study import StudySettings
from pssf.study.learn import confounded_training as learn
from pssf.study.report.report_sections import make_confounders_section
from pssf.study.statistics.analyses import confounding_effects as statistics

NAMES = ["glcm_own", "glcm_of_bmi", "glcm_of_site"]
SETTINGS = StudySettings(repeats=6, selections=("l1",), models=("lr",))


def make_cohort(seed: int = 0, subjects: int = 240) -> pd.DataFrame:
    """Return two radiographs per subject; features depend on grade, BMI and protocol, BMI does not depend on grade."""
    rng = np.random.default_rng(seed)
    grade = 2 * (np.arange(subjects) % 2)
    table = pd.DataFrame({"knee": range(subjects), "subject": range(subjects), "grade": grade})
    table["bmi"], table["age_years"] = 27 + 4 * rng.normal(size=subjects), 60 + 8 * rng.normal(size=subjects)
    table["glcm_own"] = 0.35 * grade + rng.normal(size=subjects)
    table["glcm_of_bmi"] = (table["bmi"] - 27) / 4 + 0.3 * rng.normal(size=subjects)
    parts = []
    for number, protocol in enumerate(("reference", "other")):
        of_site = 2.0 * number + rng.normal(size=subjects)
        parts.append(table.assign(protocol=protocol, glcm_of_site=of_site))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    splits = learn.evaluate_confounding(make_cohort(), NAMES, list(learn.CONFOUNDERS), SETTINGS, Execution())
    return statistics.estimate_confounding(splits).set_index(["confounder", "strength", "measure"])


@pytest.mark.parametrize("confounder", ["bmi", "site"])
def test_a_confounder_in_the_image_inflates_auc_and_adjustment_restores_it(table, confounder):
    effects = table.loc[confounder].loc[0.6]
    assert effects.loc[statistics.GAIN, "low"] > 0
    assert effects.loc[statistics.COST, "value"] > 0.03
    assert effects.loc[statistics.BACK, "value"] > 0.03
    gains = table.xs(statistics.GAIN, level="measure").loc[confounder]["value"]
    assert gains.is_monotonic_increasing
    assert abs(gains.loc[0.0]) < 0.02


def test_a_confounder_without_image_features_gives_no_gain(table):
    effects = table.loc["age_years"].loc[0.9].loc[statistics.GAIN]
    assert effects["low"] < 0 < effects["high"]
    assert abs(effects["value"]) < 0.1


@pytest.mark.parametrize("confounder", list(learn.CONFOUNDERS))
@pytest.mark.parametrize("strength", SETTINGS.strengths)
def test_a_confounded_split_has_the_requested_association_and_size(confounder, strength):
    confounded = learn.build_confounded_split(make_cohort(), confounder, strength, SETTINGS, 2)
    none = learn.build_confounded_split(make_cohort(), confounder, 0.0, SETTINGS, 2)
    for grade, side in ((2, True), (0, False)):
        part = confounded.training[confounded.training["grade"] == grade]
        assert (part["high"] == side).mean() == pytest.approx((1 + strength) / 2, abs=0.02)
        assert part["subject"].nunique() == len(part) == (none.training["grade"] == grade).sum()
    subjects = [set(part["subject"]) for part in (confounded.training, confounded.validation, confounded.test)]
    assert not subjects[0] & subjects[1]
    assert not (subjects[0] | subjects[1]) & subjects[2]


def test_weaker_confounding_uses_more_training_subjects():
    weaker = dataclasses.replace(SETTINGS, strengths=(0.0, 0.5), repeats=2)
    splits = learn.evaluate_confounding(make_cohort(), NAMES, ["bmi"], weaker, Execution())
    assert sorted(set(splits["strength"])) == [0.0, 0.5]
    assert set(statistics.estimate_confounding(splits)["strength"]) == {0.0, 0.5}
    usual = learn.build_confounded_split(make_cohort(), "bmi", 0.0, SETTINGS, 0)
    assert splits["training_subjects"].min() > usual.training["subject"].nunique()


@pytest.mark.parametrize("strength", [0.0, 0.6])
def test_cell_weights_give_the_requested_association_for_any_counts(strength):
    part = pd.DataFrame({"grade": [0, 0, 0, 2, 2, 2, 2], "high": [True, False, False, True, True, True, False]})
    part = part.assign(subject=range(7))
    weights = learn.compute_cell_weights(part, strength)
    for grade in (0, 2):
        of_grade = part["grade"] == grade
        matched = of_grade & (part["high"] == (grade == 2))
        assert weights[matched].sum() / weights[of_grade].sum() == pytest.approx((1 + strength) / 2)
    assert np.isnan(learn.compute_cell_weights(part.iloc[1:], strength)).all()


def test_confounder_slopes_are_estimated_within_grades():
    rng = np.random.default_rng(0)
    part = pd.DataFrame({"grade": 2 * (np.arange(200) % 2), "c": rng.normal(size=200)})
    part["c"] += part["grade"]
    part["both"], part["grade_alone"] = 3 * part["grade"] - 2 * part["c"], 1.0 * part["grade"]
    part["hole"] = np.where(np.arange(200) == 3, np.nan, part["c"])
    assert_allclose(learn.fit_confounder_slopes(part, ["both", "grade_alone", "hole"]), [-2, 0, 0], atol=1e-9)


def test_too_few_subjects_give_no_confounded_split(table):
    assert learn.build_confounded_split(make_cohort(subjects=12), "bmi", 0.9, SETTINGS, 0) is None
    section = make_confounders_section(table.reset_index())
    assert len(section.table) == 3 * 6
    assert section.pictures[0].png.startswith(b"\x89PNG")
