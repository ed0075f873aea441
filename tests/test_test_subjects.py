"""Numbers of test subjects per split and class, and the minimum for a decision."""

import numpy as np
import pandas as pd
import pytest

from pssf.study.predictions import ARM_COLUMNS
from pssf.study.statistics.scores.split_scores import score_splits, summarise_scores
from pssf.study.statistics.scores.tested_subjects import (
    MIN_TEST_SUBJECTS,
    MIN_TEST_SUBJECTS_PER_CLASS,
    TEST_COUNT_COLUMNS,
    count_test_subjects,
    has_enough_test_subjects,
)


def test_test_subjects_are_counted_in_total_and_in_the_rarest_class():
    subjects, truth = ["a", "a", "b", "c", "d", "d"], np.array([0, 0, 0, 0, 0, 1])
    assert count_test_subjects(subjects, truth, range(2)) == {"test_subjects": 4, "test_rarest": 1}
    assert count_test_subjects(subjects, truth, range(3)) == {"test_subjects": 4, "test_rarest": 0}


@pytest.mark.parametrize(
    ("subjects", "rarest", "decided"),
    [
        (MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS, True),
        (7, 1, False),
        (40, MIN_TEST_SUBJECTS_PER_CLASS - 1, False),
        (5, 3, False),
    ],
)
def test_a_decision_requires_enough_test_subjects_overall_and_per_class(subjects, rarest, decided):
    assert has_enough_test_subjects(dict(zip(TEST_COUNT_COLUMNS, (subjects, rarest), strict=True))) == decided


def test_scores_contain_the_number_of_test_subjects_of_the_rarest_class():
    arm = dict(zip(ARM_COLUMNS, ("0 vs 2", "within", "reference", "reference", "lr", "l1"), strict=True))
    rows = [
        arm | {"repeat": repeat, "subject": k, "truth": int(k >= 6), "p0": 0.5 - k / 20, "p1": 0.5 + k / 20}
        for repeat in range(3)
        for k in range(8 - (repeat == 2))
    ]
    splits = score_splits(pd.DataFrame(rows))
    assert splits[TEST_COUNT_COLUMNS].to_numpy().tolist() == [[8, 2], [8, 2], [7, 1]]
    assert summarise_scores(splits)[TEST_COUNT_COLUMNS].to_numpy().tolist() == [[8, 2]]
