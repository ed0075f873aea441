"""How many subjects a split tests, and whether they are enough to decide anything from."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Of a split. With fewer, intervals miss too often and some have no width; see tests/test_coverage.py.
LEAST_TESTED = 6
# And of each class: where two classes are alike it is the same, and where one is rare its few decide the scores.
LEAST_OF_A_CLASS = LEAST_TESTED // 2
TESTED = ["test_subjects", "test_rarest"]


def count_tested(
    subjects: Sequence[Any], classes: Sequence[Any] | NDArray[Any], known: Collection[Any]
) -> dict[str, int]:
    """TESTED -> how many subjects are tested, and how many of the class that has the fewest.

    subjects, classes  (rows,) of each radiograph; a subject whose knees are of two classes is of both
    known              all the classes, those that no row is of among them
    """
    names, of = np.asarray(subjects), np.asarray(classes)
    counts = [len(set(names[of == one].tolist())) for one in known]
    return dict(zip(TESTED, (len(set(names.tolist())), min(counts)), strict=True))


def enough(counts: Mapping[str, Any]) -> bool:
    """Whether anything may be decided from a split that tests so many.

    counts  TESTED -> how many; of several splits their median
    """
    subjects, rarest = (counts[name] for name in TESTED)
    return bool(subjects >= LEAST_TESTED and rarest >= LEAST_OF_A_CLASS)
