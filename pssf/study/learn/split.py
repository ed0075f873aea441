"""Training, validation and test subjects. A subject is in one of them with all its knees and radiographs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import InputError
from ..statistics.subjects import worst_grades

PARTS = ("training", "validation", "test")
_SHARES = (0.70, 0.15, 0.15)


@dataclass(frozen=True)
class Split:
    """Subjects of each part, sorted; no subject is in two."""

    training: NDArray[Any]
    validation: NDArray[Any]
    test: NDArray[Any]

    def table(self) -> pd.DataFrame:
        """subject, part: one row a subject, sorted"""
        rows = [(subject, part) for part in PARTS for subject in getattr(self, part).tolist()]
        return pd.DataFrame(sorted(rows), columns=["subject", "part"])


def split_subjects(subjects: Sequence[Any], grades: Sequence[int], *, seed: int, repeat: int = 0) -> Split:
    """70/15/15 per cent of the subjects, with every grade in every part.

    subjects  (rows,) subject of each radiograph or knee, by number or as text
    grades    (rows,) its grade; a subject counts under the highest of its knees
    repeat    another split of the same seed; it does not depend on how many there are
    raises    InputError for a grade of fewer than three subjects
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(repeat,)))
    worst = worst_grades(subjects, grades)
    parts: dict[str, list[Any]] = {part: [] for part in PARTS}
    for grade in sorted(set(worst)):
        members = worst.index[worst == grade].to_numpy()
        if len(members) < len(PARTS):
            raise InputError(
                f"grade {grade} has {len(members)} subjects with a region; allowed: {len(PARTS)} or more, one a part"
            )
        order = rng.permutation(members)
        for part, chosen in zip(PARTS, np.split(order, _cuts(len(members))), strict=True):
            parts[part].extend(chosen.tolist())
    kind = worst.index.to_numpy().dtype
    return Split(*(np.array(sorted(parts[part]), dtype=kind) for part in PARTS))


def of_grades_to_split(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of subjects of whose grade there are enough for `split_subjects`; a subject counts as it does there.

    table  one row a radiograph or knee: subject, grade
    """
    worst = worst_grades(table["subject"], table["grade"])
    counts = worst.map(worst.value_counts())
    return table[table["subject"].isin(worst.index[counts >= len(PARTS)])]


def seed_of_split(seed: int, repeat: int) -> int:
    """Seed of what is fitted on a split, which the subjects' own chance does not hang on."""
    return int(np.random.SeedSequence(seed, spawn_key=(repeat, 1)).generate_state(1)[0] >> 1)


def _cuts(count: int) -> list[int]:
    """Where to cut `count` members in three, each part at least one."""
    validation, test = (max(1, round(share * count)) for share in _SHARES[1:])
    return [count - validation - test, count - test]
