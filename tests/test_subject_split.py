"""Check splits into training, validation and test subjects."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from pssf.core.checks import InputError
from pssf.study.learn.subject_split import select_splittable_grades, split_subjects


@settings(max_examples=50)
@given(
    counts=st.tuples(*[st.integers(3, 30)] * 3),
    knees=st.integers(1, 2),
    seed=st.integers(0, 2**63 - 1),
    repeat=st.integers(0, 20),
)
def test_split_parts_are_disjoint_and_contain_every_grade(counts, knees, seed, repeat):
    grades = np.repeat([0, 1, 2], counts)
    subjects = np.arange(len(grades))
    split = split_subjects(np.repeat(subjects, knees), np.repeat(grades, knees), seed=seed, repeat=repeat)
    parts = [split.training, split.validation, split.test]
    assert_array_equal(np.sort(np.concatenate(parts)), subjects)
    for part in parts:
        assert set(grades[part]) == {0, 1, 2}
    assert len(split.training) >= 0.5 * len(subjects) - 3


def test_a_split_depends_on_seed_and_repeat_but_not_on_row_order():
    subjects, grades = np.arange(40), np.arange(40) % 3
    order = np.random.default_rng(0).permutation(40)
    first = split_subjects(subjects, grades, seed=5, repeat=1)
    assert_array_equal(first.test, split_subjects(subjects[order], grades[order], seed=5, repeat=1).test)
    assert set(first.test) != set(split_subjects(subjects, grades, seed=5, repeat=2).test)
    assert set(first.test) != set(split_subjects(subjects, grades, seed=6, repeat=1).test)


def test_a_split_of_200_subjects_has_70_15_and_15_percent():
    split = split_subjects(np.arange(200), np.zeros(200, int), seed=0)
    assert [len(split.training), len(split.validation), len(split.test)] == [140, 30, 30]


def test_too_few_subjects_of_a_grade_raise_an_error():
    with pytest.raises(InputError, match=r"grade 1 must have at least 3 subjects .*got 2"):
        split_subjects([0, 1, 2, 3, 4], [0, 0, 0, 1, 1], seed=0)


def test_subject_identifiers_may_be_strings():
    numbers = [subject for subject in range(40) for _ in range(2)]
    texts = [f"P-{subject:02d}" for subject in numbers]
    grades = [subject % 2 for subject in numbers]
    by_number, by_text = (split_subjects(names, grades, seed=3) for names in (numbers, texts))
    assert by_text.to_table()["subject"].tolist() == [f"P-{subject:02d}" for subject in by_number.to_table()["subject"]]
    assert by_text.to_table()["part"].tolist() == by_number.to_table()["part"].tolist()


def test_grades_with_too_few_subjects_are_excluded_on_request():
    # Subject 8 has knees with grades 1 and 2 and counts as grade 2, so grade 1 has two subjects.
    table = pd.DataFrame(
        {"subject": [0, 1, 2, 3, 3, 4, 4, 5, 6, 7, 8, 8], "grade": [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 1, 2]}
    )
    with pytest.raises(InputError, match=r"grade 1 must have at least 3 subjects .*got 2"):
        split_subjects(table["subject"], table["grade"], seed=0)
    left = select_splittable_grades(table)
    assert sorted(set(left["subject"])) == [0, 1, 2, 5, 6, 7, 8]
    assert len(left) == 8
    split = split_subjects(left["subject"], left["grade"], seed=0)
    assert sum(len(part) for part in (split.training, split.validation, split.test)) == 7
    assert select_splittable_grades(left).equals(left)
    assert select_splittable_grades(table[:2]).empty
