"""Number of test subjects per split, and the smallest number that allows a decision on a claim."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Smallest number of test subjects per split. With fewer subjects, the coverage of the intervals is too low and some
# intervals have no width; see tests/test_interval_coverage.py.
MIN_TEST_SUBJECTS = 6
# Smallest number of test subjects per class; scores depend mainly on the subjects of the rarest class.
MIN_TEST_SUBJECTS_PER_CLASS = MIN_TEST_SUBJECTS // 2
# Columns with the number of test subjects and the number of test subjects in the rarest class.
TEST_COUNT_COLUMNS = ["test_subjects", "test_rarest"]


def count_test_subjects(
    subjects: Sequence[Any], classes: Sequence[Any] | NDArray[Any], all_classes: Collection[Any]
) -> dict[str, int]:
    """Count all test subjects and the test subjects of the rarest class.

    Parameters
    ----------
    subjects : sequence
        Subject identifier of each test radiograph.
    classes : sequence or (rows,) array
        Class of each test radiograph; a subject with knees of two classes is counted in both classes.
    all_classes : collection
        All classes, including classes without a radiograph.

    Returns
    -------
    dict of str to int
        Counts, keyed by `TEST_COUNT_COLUMNS`.
    """
    names, of = np.asarray(subjects), np.asarray(classes)
    counts = [len(set(names[of == one].tolist())) for one in all_classes]
    return dict(zip(TEST_COUNT_COLUMNS, (len(set(names.tolist())), min(counts)), strict=True))


def has_enough_test_subjects(counts: Mapping[str, Any]) -> bool:
    """Check whether a split has enough test subjects for a decision on a claim.

    Parameters
    ----------
    counts : mapping of str to Any
        Counts, keyed by `TEST_COUNT_COLUMNS`; for several splits, their medians.

    Returns
    -------
    bool
        True if there are enough subjects in total and in each class.
    """
    subjects, rarest = (counts[name] for name in TEST_COUNT_COLUMNS)
    return bool(subjects >= MIN_TEST_SUBJECTS and rarest >= MIN_TEST_SUBJECTS_PER_CLASS)
