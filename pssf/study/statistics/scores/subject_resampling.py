"""Grades of subjects, and bootstrap samples of subjects."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ....core.checks import Array


def worst_grades(subjects: Sequence[Any], grades: Sequence[int]) -> pd.Series:
    """Find the highest grade of each subject, under which the subject counts.

    Parameters
    ----------
    subjects : sequence
        Subject of each radiograph or knee, as number or text.
    grades : sequence of int
        Grade of each radiograph or knee.

    Returns
    -------
    Series
        Highest grade by subject, sorted by subject.
    """
    return pd.Series(np.asarray(grades)).groupby(np.asarray(subjects)).max()


def sample_bootstrap_counts(worst: pd.Series, *, replicates: int, seed: int, stream: int) -> Array:
    """Sample how often each subject is in a bootstrap sample stratified by grade.

    Parameters
    ----------
    worst : Series
        Grade of each subject, of `worst_grades`.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the study.
    stream : int
        Key of the random stream below the seed.

    Returns
    -------
    (subjects, 1 + replicates) float array
        Counts; the first column is ones.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
    weights = np.ones((len(worst), 1 + replicates))
    for grade in sorted(set(worst)):
        members = np.flatnonzero(worst == grade)
        weights[members, 1:] = rng.multinomial(len(members), np.full(len(members), 1 / len(members)), replicates).T
    return weights
