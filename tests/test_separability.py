"""What the parameters alone tell of the grades, which is as much as an image could."""

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


def separability(table, **how):
    return learn.estimate_separability(load_knee_distributions(table), load_landmark_reference().gap_alone_auc, **how)


@pytest.fixture(scope="module")
def people():
    return separability("population", knees=600, seed=3).set_index(["grades", "known", "how"])


def test_spaces_of_the_papers_table_tell_its_grades_and_those_of_people_do_not(people):
    paper = separability("paper", knees=300, seed=3).set_index(["grades", "known", "how"])
    assert paper.loc[("0 vs 2", "smaller JSW", "by rank"), "auc"] > 0.99
    early = people.loc[("0 vs 2", "smaller JSW", "by rank")]
    assert early["auc"] < 0.72
    assert people.loc[("0 vs 4", "smaller JSW", "by rank"), "auc"] > 0.95
    assert np.isfinite(early["people"])


def test_all_parameters_tell_more_than_spaces_alone_and_later_grades_more_than_early_ones(people):
    best = people.groupby(level=["grades", "known"])["auc"].max()
    assert best[("0 vs 2", "all parameters")] > best[("0 vs 2", "JSW")] + 0.1
    later = [best[(f"0 vs {grade}", "all parameters")] for grade in (1, 2, 3)]
    assert later == sorted(later)
    assert people["auc"].between(people["low"], people["high"]).all()


@pytest.mark.slow
def test_twice_as_many_knees_tell_no_more_than_the_interval_says_and_ends_of_laws_are_part_of_what_is_told():
    """Of the grades that are told worst; knees of the others are not drawn. Of 1,000 knees in all it fails."""
    pair = 2 * learn.DEFAULT_KNEE_COUNT // len(load_knee_distributions("population").grades.grades)
    worse, rng, laws = np.arange(2 * pair) % 2 == 1, np.random.default_rng(7), load_knee_distributions("population")
    table = build_parameter_table(
        [sample_knee_from_distributions(laws, grade=int(one), rng=rng) for one in worse], MODES
    )
    half, whole = (told(table[:count], worse[:count]) for count in (pair, 2 * pair))
    assert half["low"] <= whole["auc"] <= half["high"]
    assert whole["low"] <= half["auc"] <= whole["high"]
    # Known to a tenth of what it spreads by, a value on the end of a law is one as any other.
    spread = np.where(table.nunique() > 50, table.std(), 0.0)
    read = table + 0.1 * spread * rng.normal(size=table.shape)
    assert told(read[:pair], worse[:pair])["auc"] == pytest.approx(half["auc"] - 0.03, abs=0.012)


def told(table, worse):
    return learn._estimate_auc(learn._predict_held_out(table.to_numpy(), worse, "boosted trees", 0), worse)


def test_a_study_and_the_command_draw_as_many_knees():
    asked = inspect.signature(measuring_commands.separability).parameters["knees"].default
    assert (
        asked == learn.DEFAULT_KNEE_COUNT == inspect.signature(learn.estimate_separability).parameters["knees"].default
    )


def test_a_draw_is_repeated_by_its_seed_alone():
    one, two = (separability("paper", knees=60, seed=1) for _ in range(2))
    assert one.equals(two)
    assert not one.equals(separability("paper", knees=60, seed=2))


def test_no_grade_nor_texture_is_among_what_is_known():
    any_of = Knee(jsw_medial_mm=3.0, osteophytes=(Osteophyte(site="medial_tibia", size_mm=2.0),))  # KL 2 to 4
    one, other = (
        build_parameter_table(
            [dataclasses.replace(any_of, grade=grade, reader_grade=grade, texture_seed=grade, side=side)], MODES
        )
        for grade, side in ((2, "left"), (4, "right"))
    )
    assert one.equals(other)
    beak = build_parameter_table([Knee(osteophytes=(Osteophyte(site="lateral_tibia", size_mm=3.0),))], MODES)
    assert beak["osteophyte_lateral_tibia_mm"].item() == 3.0


def test_too_few_knees_are_refused():
    with pytest.raises(InputError, match=r"knees must be .*, got 20"):
        separability("population", knees=20)


def test_the_command_prints_a_table_and_writes_it(tmp_path):
    asked = ["separability", "--grade-table", "paper", "--knees", "60", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    assert "all parameters" in result.output
    lines = (tmp_path / "separability.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 5
