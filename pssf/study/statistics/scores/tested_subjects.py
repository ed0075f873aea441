"""Numbers of test subjects, and whether they suffice for a decision."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Smallest number of test subjects per split. With fewer, intervals cover too rarely and some have no width; see
# tests/test_coverage.py.
MIN_TEST_SUBJECTS = 6
# Smallest number of test subjects per class. The few subjects of a rare class decide the scores.
MIN_TEST_SUBJECTS_PER_CLASS = MIN_TEST_SUBJECTS // 2
# Columns with the number of test subjects and the number of the rarest class.
TEST_COUNT_COLUMNS = ["test_subjects", "test_rarest"]


def count_test_subjects(
    subjects: Sequence[Any], classes: Sequence[Any] | NDArray[Any], all_classes: Collection[Any]
) -> dict[str, int]:
    """Count the test subjects, and those of the class with the fewest.

    Parameters
    ----------
    subjects : sequence
        Subject of each radiograph.
    classes : sequence or (rows,) array
        Class of each radiograph; a subject whose knees are of two classes counts in both.
    all_classes : collection
        All classes, including those without a row.

    Returns
    -------
    dict of str to int
        Counts by `TEST_COUNT_COLUMNS`.
    """
    names, of = np.asarray(subjects), np.asarray(classes)
    counts = [len(set(names[of == one].tolist())) for one in all_classes]
    return dict(zip(TEST_COUNT_COLUMNS, (len(set(names.tolist())), min(counts)), strict=True))


def has_enough_test_subjects(counts: Mapping[str, Any]) -> bool:
    """Check that a split tests enough subjects for a decision.

    Parameters
    ----------
    counts : mapping of str to Any
        Counts by `TEST_COUNT_COLUMNS`; of several splits, their median.

    Returns
    -------
    bool
        True if there are enough subjects in total and in each class.
    """
    subjects, rarest = (counts[name] for name in TEST_COUNT_COLUMNS)
    return bool(subjects >= MIN_TEST_SUBJECTS and rarest >= MIN_TEST_SUBJECTS_PER_CLASS)
