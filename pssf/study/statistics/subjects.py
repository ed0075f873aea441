"""Subjects by their worst knee, and samples of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...core.checks import Array


def worst_grades(subjects: Sequence[Any], grades: Sequence[int]) -> pd.Series:
    """subject -> the highest grade of its rows, which it counts under; by subject, in order

    subjects, grades  (rows,) of each radiograph or knee; subjects by number or as text
    """
    return pd.Series(np.asarray(grades)).groupby(np.asarray(subjects)).max()


def draws(worst: pd.Series, *, replicates: int, seed: int, stream: int) -> Array:
    """(subjects, 1 + replicates)  how often each subject is in a sample drawn within grades; ones in the first column

    worst   (subjects,) grade of each
    stream  key of the chance, beside the others of a seed
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
    weights = np.ones((len(worst), 1 + replicates))
    for grade in sorted(set(worst)):
        members = np.flatnonzero(worst == grade)
        weights[members, 1:] = rng.multinomial(len(members), np.full(len(members), 1 / len(members)), replicates).T
    return weights
