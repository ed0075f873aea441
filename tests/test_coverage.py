"""Coverage of the study's intervals, by the cohorts of `pssf.validation.study_methods.interval_coverage`.

What is asked of the intervals is 95 %; misses are binomial, and bounds at four standard deviations.
"""

import numpy as np
import pytest

from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.scores.metrics import score_predictions
from pssf.study.statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS
from pssf.validation.study_methods.interval_coverage import (
    MINIMUM_SUBJECTS,
    count_missed_intervals,
    mean_macro_f1,
    measure_interval_coverage,
)

# Of the rarer grade as few as may be tested, of the other one three times as many.
FEW_OF_ONE = (60, 20)


def most(cohorts: int) -> float:
    """Misses of intervals that hold the truth in 95 %: their number, and four standard deviations more."""
    return 0.05 * cohorts + 4 * np.sqrt(0.05 * 0.95 * cohorts)


def test_the_fewest_subjects_that_decide_anything_are_tested_here():
    for subjects, tested in ((MINIMUM_SUBJECTS, MIN_TEST_SUBJECTS), (FEW_OF_ONE, 4 * MIN_TEST_SUBJECTS_PER_CLASS)):
        grade = np.repeat([0, 1], subjects)
        test = split_subjects(range(len(grade)), grade, seed=0).test
        assert (len(test), (grade[test] == 1).sum()) == (tested, MIN_TEST_SUBJECTS_PER_CLASS)


@pytest.mark.parametrize("tested", [(3, 3), (7, 2)], ids=str)
def test_the_mean_f1_of_small_tests_is_that_of_tests_drawn(tested):
    rng, right, drawn = np.random.default_rng(2), (0.8, 0.6), []
    truth = np.repeat([0, 1], tested)
    for _ in range(4000):
        called = np.where(rng.random(len(truth)) < np.repeat(right, tested), truth, 1 - truth)
        drawn.append(score_predictions(truth, np.eye(2)[called])["macro_f1"])
    assert mean_macro_f1(right, tested) == pytest.approx(np.mean(drawn), abs=4 * np.std(drawn) / np.sqrt(4000))


def test_the_mean_f1_of_tests_is_less_than_that_of_endless_ones():
    right = (0.8, 0.6)
    # That of endless ones, which is more, is what tests come to as they grow.
    endless = np.mean([2 * a / (2 * a + (1 - b) + (1 - a)) for a, b in (right, right[::-1])])
    assert mean_macro_f1(right, (3, 3)) < endless == pytest.approx(mean_macro_f1(right, (400, 400)), abs=1e-3)


def test_a_table_has_every_measure_at_every_distance_and_what_was_done_before():
    rows = measure_interval_coverage(workers=1, cohorts=2)
    assert len(rows) == 3 * 7
    assert {row["cohorts"] for row in rows} == {2}
    assert all(row["held"] in (0, 0.5, 1) for row in rows)
    assert rows[0]["true_auc"] == pytest.approx(0.5, abs=1e-9)
    assert rows[-1]["true_auc"] > 0.8


def test_intervals_hold_the_truth_where_models_are_trained_anew():
    found = count_missed_intervals(2.0, MINIMUM_SUBJECTS, 30)
    assert (found.drop(["bootstrap", "no width"]) <= most(30)).all(), found
    # A bootstrap over splits that overlap, held to the same bound.
    assert found["bootstrap"] > most(30), found
    assert found["no width"] <= 1


def test_intervals_hold_the_truth_where_one_grade_is_rare_and_three_of_it_are_tested():
    found = count_missed_intervals(2.0, FEW_OF_ONE, 30)
    assert (found.drop(["bootstrap", "no width"]) <= most(30)).all(), found


@pytest.mark.slow
@pytest.mark.parametrize(("apart", "subjects"), [(2.0, FEW_OF_ONE), (1.2, FEW_OF_ONE[::-1]), (2.0, (200, 20))])
def test_intervals_hold_the_truth_with_three_tested_of_the_rarer_grade_however_many_of_the_other(apart, subjects):
    found = count_missed_intervals(apart, subjects, 200)
    assert (found.drop(["bootstrap", "no width"]) <= most(200)).all(), found


@pytest.mark.slow
def test_of_seven_tested_with_one_of_the_rarer_grade_intervals_miss_too_often():
    # Which is why fewer than three of a grade decide nothing, whatever their number in all.
    found = count_missed_intervals(1.2, (7, 40), 200)
    assert (found[["balanced_accuracy", "macro_f1"]] > most(200)).all(), found


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.0, 1.2, 2.0])
def test_intervals_hold_the_truth_and_a_bootstrap_over_overlapping_splits_does_not(apart):
    found = count_missed_intervals(apart, MINIMUM_SUBJECTS, 200)
    assert (found.drop(["bootstrap", "no width"]) <= most(200)).all(), found
    assert found["bootstrap"] > 0.05 * 200 + 2 * np.sqrt(0.05 * 0.95 * 200), found


@pytest.mark.slow
def test_with_two_tested_subjects_one_interval_in_ten_has_no_width():
    # Which is why fewer decide nothing.
    assert count_missed_intervals(2.0, (8, 8), 100)["no width"] >= 10
