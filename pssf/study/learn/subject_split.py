"""Splits of subjects into training, validation and test sets; all radiographs of a subject are in the same set."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import InputError
from ..statistics.scores.subject_resampling import worst_grades

PARTS = ("training", "validation", "test")
# Fractions of the subjects in the training, validation and test sets.
_PART_FRACTIONS = (0.70, 0.15, 0.15)


@dataclass(frozen=True)
class Split:
    """Training, validation and test subjects, each sorted; no subject is in two sets.

    Attributes
    ----------
    training : (subjects,) array
        Subjects for fitting models.
    validation : (subjects,) array
        Subjects for selecting hyperparameters.
    test : (subjects,) array
        Subjects for testing models.
    """

    training: NDArray[Any]
    validation: NDArray[Any]
    test: NDArray[Any]

    def to_table(self) -> pd.DataFrame:
        """Convert the split to a table.

        Returns
        -------
        DataFrame
            Columns subject and part (training, validation or test); one row per subject, sorted.
        """
        rows = [(subject, part) for part in PARTS for subject in getattr(self, part).tolist()]
        return pd.DataFrame(sorted(rows), columns=["subject", "part"])


def split_subjects(subjects: Sequence[Any], grades: Sequence[int], *, seed: int, repeat: int = 0) -> Split:
    """Split the subjects into 70 % training, 15 % validation and 15 % test subjects, with every grade in every set.

    Parameters
    ----------
    subjects : sequence
        Subject identifier of each radiograph or knee, as number or text.
    grades : sequence of int
        Grade of each radiograph or knee; the grade of a subject is the highest grade of the knees.
    seed : int
        Seed of the study.
    repeat : int, default 0
        Index of the split, starting at 0. The result is independent of the total number of splits.

    Returns
    -------
    Split
        Training, validation and test subjects.

    Raises
    ------
    InputError
        A grade has fewer than three subjects.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(repeat,)))
    worst = worst_grades(subjects, grades)
    parts: dict[str, list[Any]] = {part: [] for part in PARTS}
    for grade in sorted(set(worst)):
        members = worst.index[worst == grade].to_numpy()
        if len(members) < len(PARTS):
            raise InputError(
                f"grade {grade} must have at least {len(PARTS)} subjects with a located region, got {len(members)}: "
                "each of the three sets needs one subject"
            )
        order = rng.permutation(members)
        for part, chosen in zip(PARTS, np.split(order, _compute_cut_points(len(members))), strict=True):
            parts[part].extend(chosen.tolist())
    kind = worst.index.to_numpy().dtype
    return Split(*(np.array(sorted(parts[part]), dtype=kind) for part in PARTS))


def select_splittable_grades(table: pd.DataFrame) -> pd.DataFrame:
    """Select the rows of subjects with a grade that has enough subjects for `split_subjects`.

    Parameters
    ----------
    table : DataFrame
        One row per radiograph or knee: subject and grade.

    Returns
    -------
    DataFrame
        Rows of the selected subjects.
    """
    worst = worst_grades(table["subject"], table["grade"])
    counts = worst.map(worst.value_counts())
    return table[table["subject"].isin(worst.index[counts >= len(PARTS)])]


def derive_split_seed(seed: int, repeat: int) -> int:
    """Derive the seed for models and feature selections of a split; the split itself uses another random stream.

    Parameters
    ----------
    seed : int
        Seed of the study.
    repeat : int
        Index of the split, starting at 0.

    Returns
    -------
    int
        Seed for models and feature selections.
    """
    return int(np.random.SeedSequence(seed, spawn_key=(repeat, 1)).generate_state(1)[0] >> 1)


def _compute_cut_points(count: int) -> list[int]:
    """Compute the two indices that divide `count` subjects into three sets of at least one subject each."""
    validation, test = (max(1, round(share * count)) for share in _PART_FRACTIONS[1:])
    return [count - validation - test, count - test]
