"""Confounders by design: cohorts in which a feature follows the confounder, and nothing else that tells grades."""

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
SETTINGS = StudySettings(repeats=10, selections=("l1",), models=("lr",))


def cohort(seed: int = 0, subjects: int = 240) -> pd.DataFrame:
    """Two radiographs a subject: a weak sign of the grade, one of the BMI, one of the protocol; BMI is not of grade."""
    rng = np.random.default_rng(seed)
    grade = 2 * (np.arange(subjects) % 2)
    table = pd.DataFrame({"knee": range(subjects), "subject": range(subjects), "grade": grade})
    table["bmi"], table["age_years"] = 27 + 4 * rng.normal(size=subjects), 60 + 8 * rng.normal(size=subjects)
    table["glcm_own"] = 0.35 * grade + rng.normal(size=subjects)
    table["glcm_of_bmi"] = (table["bmi"] - 27) / 4 + 0.3 * rng.normal(size=subjects)
    parts = []
    for place, protocol in enumerate(("reference", "other")):
        of_site = 2.0 * place + rng.normal(size=subjects)
        parts.append(table.assign(protocol=protocol, glcm_of_site=of_site))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    splits = learn.evaluate_confounding(cohort(), NAMES, list(learn.CONFOUNDERS), SETTINGS, Execution())
    return statistics.estimate_confounding(splits).set_index(["confounder", "strength", "measure"])


@pytest.mark.parametrize("confounder", ["bmi", "site"])
def test_a_naive_model_gains_by_what_an_image_shows_and_pays_elsewhere_and_adjustment_gives_it_back(table, confounder):
    of = table.loc[confounder].loc[0.6]
    assert of.loc[statistics.GAIN, "low"] > 0
    assert of.loc[statistics.COST, "value"] > 0.03
    assert of.loc[statistics.BACK, "value"] > 0.03
    gains = table.xs(statistics.GAIN, level="measure").loc[confounder]["value"]
    assert gains.is_monotonic_increasing
    assert abs(gains.loc[0.0]) < 0.02


def test_what_no_image_shows_is_not_gained_by(table):
    of = table.loc["age_years"].loc[0.9].loc[statistics.GAIN]
    assert of["low"] < 0 < of["high"]
    assert abs(of["value"]) < 0.1


@pytest.mark.parametrize("confounder", list(learn.CONFOUNDERS))
@pytest.mark.parametrize("strength", SETTINGS.strengths)
def test_a_tie_is_as_strong_as_asked_of_as_many_subjects_and_keeps_the_split(confounder, strength):
    tie = learn.build_confounded_split(cohort(), confounder, strength, SETTINGS, 2)
    none = learn.build_confounded_split(cohort(), confounder, 0.0, SETTINGS, 2)
    for grade, side in ((2, True), (0, False)):
        part = tie.training[tie.training["grade"] == grade]
        assert (part["high"] == side).mean() == pytest.approx((1 + strength) / 2, abs=0.02)
        assert part["subject"].nunique() == len(part) == (none.training["grade"] == grade).sum()
    subjects = [set(part["subject"]) for part in (tie.training, tie.validation, tie.test)]
    assert not subjects[0] & subjects[1]
    assert not (subjects[0] | subjects[1]) & subjects[2]


def test_strengths_are_those_asked_for_and_more_of_the_subjects_serve_weaker_ones():
    weaker = dataclasses.replace(SETTINGS, strengths=(0.0, 0.5), repeats=2)
    splits = learn.evaluate_confounding(cohort(), NAMES, ["bmi"], weaker, Execution())
    assert sorted(set(splits["strength"])) == [0.0, 0.5]
    assert set(statistics.estimate_confounding(splits)["strength"]) == {0.0, 0.5}
    usual = learn.build_confounded_split(cohort(), "bmi", 0.0, SETTINGS, 0)
    assert splits["trained"].min() > usual.training["subject"].nunique()


@pytest.mark.parametrize("strength", [0.0, 0.6])
def test_weights_tie_the_tested_whatever_their_counts(strength):
    part = pd.DataFrame({"grade": [0, 0, 0, 2, 2, 2, 2], "high": [True, False, False, True, True, True, False]})
    part = part.assign(subject=range(7))
    weights = learn.compute_cell_weights(part, strength)
    for grade in (0, 2):
        of = part["grade"] == grade
        matched = of & (part["high"] == (grade == 2))
        assert weights[matched].sum() / weights[of].sum() == pytest.approx((1 + strength) / 2)
    assert np.isnan(learn.compute_cell_weights(part.iloc[1:], strength)).all()


def test_what_is_taken_out_is_what_a_feature_follows_at_a_given_grade():
    rng = np.random.default_rng(0)
    part = pd.DataFrame({"grade": 2 * (np.arange(200) % 2), "c": rng.normal(size=200)})
    part["c"] += part["grade"]
    part["both"], part["grade_alone"] = 3 * part["grade"] - 2 * part["c"], 1.0 * part["grade"]
    part["hole"] = np.where(np.arange(200) == 3, np.nan, part["c"])
    assert_allclose(learn.fit_confounder_slopes(part, ["both", "grade_alone", "hole"]), [-2, 0, 0], atol=1e-9)


def test_too_few_subjects_are_not_tied_and_the_report_shows_the_rest(table):
    assert learn.build_confounded_split(cohort(subjects=12), "bmi", 0.9, SETTINGS, 0) is None
    section = make_confounders_section(table.reset_index())
    assert len(section.table) == 3 * 6
    assert section.pictures[0].png.startswith(b"\x89PNG")
