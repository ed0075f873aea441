"""Check the coverage of the study's confidence intervals by simulation.

The intervals should cover 95 %. The number of misses is binomial; each bound is four standard deviations above the
expected number.
"""

import itertools

import numpy as np
import pytest
from scipy.stats import binom

from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.scores.metrics import score_predictions
from pssf.study.statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS
from pssf.validation.study_methods.interval_coverage import (
    MINIMUM_SUBJECTS,
    count_missed_intervals,
    mean_macro_f1,
    measure_interval_coverage,
)

# The rarer grade has the minimum number of test subjects, the other grade three times as many.
UNBALANCED_SUBJECTS = (60, 20)


def compute_maximum_misses(cohorts: int) -> float:
    """Return the expected misses of 95 % intervals plus four standard deviations."""
    return 0.05 * cohorts + 4 * np.sqrt(0.05 * 0.95 * cohorts)


def test_the_smallest_allowed_cohorts_have_the_minimum_test_subjects():
    for subjects, tested in (
        (MINIMUM_SUBJECTS, MIN_TEST_SUBJECTS),
        (UNBALANCED_SUBJECTS, 4 * MIN_TEST_SUBJECTS_PER_CLASS),
    ):
        grade = np.repeat([0, 1], subjects)
        test = split_subjects(range(len(grade)), grade, seed=0).test
        assert (len(test), (grade[test] == 1).sum()) == (tested, MIN_TEST_SUBJECTS_PER_CLASS)


@pytest.mark.parametrize("tested", [(3, 3), (7, 2)], ids=str)
def test_the_mean_macro_f1_is_the_mean_over_all_possible_predictions(tested):
    accuracy, truth, mean = (0.8, 0.6), np.repeat([0, 1], tested), 0.0
    for right in itertools.product(*(range(count + 1) for count in tested)):
        predicted = np.concatenate(
            [
                np.where(np.arange(count) < correct, grade, 1 - grade)
                for grade, count, correct in zip((0, 1), tested, right, strict=True)
            ]
        )
        probability = np.prod(binom.pmf(right, tested, accuracy))
        mean += probability * score_predictions(truth, np.eye(2)[predicted])["macro_f1"]
    assert mean_macro_f1(accuracy, tested) == pytest.approx(mean, abs=1e-12)


def test_the_mean_macro_f1_of_small_test_sets_is_below_its_limit():
    accuracy = (0.8, 0.6)
    # The mean rises to this limit as the test sets grow.
    limit = np.mean([2 * a / (2 * a + (1 - b) + (1 - a)) for a, b in (accuracy, accuracy[::-1])])
    assert mean_macro_f1(accuracy, (3, 3)) < limit == pytest.approx(mean_macro_f1(accuracy, (400, 400)), abs=1e-3)


@pytest.mark.slow
def test_the_coverage_table_has_every_measure_at_every_distance():
    rows = measure_interval_coverage(workers=1, cohorts=2)
    assert len(rows) == 3 * 7
    assert {row["cohorts"] for row in rows} == {2}
    assert all(row["held"] in (0, 0.5, 1) for row in rows)
    assert rows[0]["true_auc"] == pytest.approx(0.5, abs=1e-9)
    assert rows[-1]["true_auc"] > 0.8


@pytest.mark.slow
def test_intervals_cover_the_truth_when_models_are_retrained():
    found = count_missed_intervals(2.0, MINIMUM_SUBJECTS, 30)
    assert (found.drop(["bootstrap", "no width"]) <= compute_maximum_misses(30)).all(), found
    # The naive bootstrap over overlapping splits misses more often than the bound allows.
    assert found["bootstrap"] > compute_maximum_misses(30), found
    assert found["no width"] <= 1


@pytest.mark.slow
def test_intervals_cover_the_truth_with_three_test_subjects_per_grade():
    found = count_missed_intervals(2.0, UNBALANCED_SUBJECTS, 30)
    assert (found.drop(["bootstrap", "no width"]) <= compute_maximum_misses(30)).all(), found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distance", "subjects"), [(2.0, UNBALANCED_SUBJECTS), (1.2, UNBALANCED_SUBJECTS[::-1]), (2.0, (200, 20))]
)
def test_intervals_cover_the_truth_for_any_ratio_of_grades(distance, subjects):
    found = count_missed_intervals(distance, subjects, 200)
    assert (found.drop(["bootstrap", "no width"]) <= compute_maximum_misses(200)).all(), found


@pytest.mark.slow
def test_intervals_of_one_test_subject_per_grade_miss_too_often():
    # The study therefore leaves claims undecided with fewer than three test subjects of a grade.
    found = count_missed_intervals(1.2, (7, 40), 200)
    assert (found[["balanced_accuracy", "macro_f1"]] > compute_maximum_misses(200)).all(), found


@pytest.mark.slow
@pytest.mark.parametrize("distance", [0.0, 1.2, 2.0])
def test_intervals_cover_the_truth_unlike_a_bootstrap_over_splits(distance):
    found = count_missed_intervals(distance, MINIMUM_SUBJECTS, 200)
    assert (found.drop(["bootstrap", "no width"]) <= compute_maximum_misses(200)).all(), found
    assert found["bootstrap"] > 0.05 * 200 + 2 * np.sqrt(0.05 * 0.95 * 200), found


@pytest.mark.slow
def test_one_in_ten_intervals_of_two_test_subjects_has_zero_width():
    # The study therefore leaves claims undecided with so few test subjects.
    assert count_missed_intervals(2.0, (8, 8), 100)["no width"] >= 10
