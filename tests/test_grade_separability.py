"""Check the separability of grades by knee parameters alone, an upper bound for any image feature."""

import dataclasses
import inspect

import numpy as np
import pytest
from typer.testing import CliRunner

from pssf import InputError, Knee, Osteophyte
from pssf.cli import app, measuring_commands
from pssf.data.analysis.landmark_table import load_landmark_reference
from pssf.data.anatomy.shape_table import load_shape_model
from pssf.model.sampling.knee_sampling import load_knee_distributions, sample_knee_from_distributions
from pssf.study.learn import grade_separability as learn
from pssf.study.learn.grade_separability import build_parameter_table

MODES = len(load_shape_model().modes)


def estimate_separability(table, **options):
    return learn.estimate_separability(
        load_knee_distributions(table), load_landmark_reference().gap_alone_auc, **options
    )


@pytest.fixture(scope="module")
def population():
    return estimate_separability("population", knees=600, seed=3).set_index(["grades", "parameters", "method"])


def test_jsw_separates_grades_of_the_paper_table_but_not_of_population(population):
    paper = estimate_separability("paper", knees=300, seed=3).set_index(["grades", "parameters", "method"])
    assert paper.loc[("0 vs 2", "smaller JSW", "by rank"), "auc"] > 0.99
    early = population.loc[("0 vs 2", "smaller JSW", "by rank")]
    assert early["auc"] < 0.72
    assert population.loc[("0 vs 4", "smaller JSW", "by rank"), "auc"] > 0.95
    assert np.isfinite(early["patient_auc"])


def test_all_parameters_together_separate_grades_better_than_jsw(population):
    best = population.groupby(level=["grades", "parameters"])["auc"].max()
    assert best[("0 vs 2", "all parameters")] > best[("0 vs 2", "JSW")] + 0.1
    later = [best[(f"0 vs {grade}", "all parameters")] for grade in (1, 2, 3)]
    assert later == sorted(later)
    assert population["auc"].between(population["low"], population["high"]).all()


@pytest.mark.slow
def test_doubling_the_number_of_knees_keeps_the_auc_within_its_interval():
    """Sample only the two least separable grades; the test fails with 1,000 knees in total."""
    pair = 2 * learn.DEFAULT_KNEE_COUNT // len(load_knee_distributions("population").grades.grades)
    worse, rng, laws = np.arange(2 * pair) % 2 == 1, np.random.default_rng(7), load_knee_distributions("population")
    table = build_parameter_table(
        [sample_knee_from_distributions(laws, grade=int(one), rng=rng) for one in worse], MODES
    )
    half, whole = (score_parameters(table[:count], worse[:count]) for count in (pair, 2 * pair))
    assert half["low"] <= whole["auc"] <= half["high"]
    assert whole["low"] <= half["auc"] <= whole["high"]
    # A measurement error of 0.1 SD hides the limits of the sampled ranges, which would reveal the grade.
    spread = np.where(table.nunique() > 50, table.std(), 0.0)
    read = table + 0.1 * spread * rng.normal(size=table.shape)
    assert score_parameters(read[:pair], worse[:pair])["auc"] == pytest.approx(half["auc"] - 0.03, abs=0.012)


def score_parameters(table, worse):
    return learn._estimate_auc(learn._predict_held_out(table.to_numpy(), worse, "boosted trees", 0), worse)


def test_study_and_command_sample_the_same_number_of_knees_by_default():
    default = inspect.signature(measuring_commands.separability).parameters["knees"].default
    assert (
        default
        == learn.DEFAULT_KNEE_COUNT
        == inspect.signature(learn.estimate_separability).parameters["knees"].default
    )


def test_separability_depends_only_on_the_seed():
    one, two = (estimate_separability("paper", knees=60, seed=1) for _ in range(2))
    assert one.equals(two)
    assert not one.equals(estimate_separability("paper", knees=60, seed=2))


def test_separability_parameters_exclude_grade_texture_and_side():
    # This anatomy is compatible with KL grades 2 to 4.
    knee = Knee(jsw_medial_mm=3.0, osteophytes=(Osteophyte(site="medial_tibia", size_mm=2.0),))
    one, other = (
        build_parameter_table(
            [dataclasses.replace(knee, grade=grade, reader_grade=grade, texture_seed=grade, side=side)], MODES
        )
        for grade, side in ((2, "left"), (4, "right"))
    )
    assert one.equals(other)
    beak = build_parameter_table([Knee(osteophytes=(Osteophyte(site="lateral_tibia", size_mm=3.0),))], MODES)
    assert beak["osteophyte_lateral_tibia_mm"].item() == 3.0


def test_too_few_knees_raise_an_error():
    with pytest.raises(InputError, match=r"knees must be .*, got 20"):
        estimate_separability("population", knees=20)


def test_the_separability_command_prints_and_writes_a_table(tmp_path):
    arguments = ["separability", "--grade-table", "paper", "--knees", "60", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "all parameters" in result.output
    lines = (tmp_path / "separability.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 5
