"""Grades of subjects, and bootstrap samples of subjects."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ....core.checks import Array


def worst_grades(subjects: Sequence[Any], grades: Sequence[int]) -> pd.Series:
    """Find the highest grade of each subject, which serves as the grade of the subject.

    Parameters
    ----------
    subjects : sequence
        Subject identifier of each radiograph or knee, as number or text.
    grades : sequence of int
        Grade of each radiograph or knee.

    Returns
    -------
    Series
        Highest grade, indexed by subject and sorted by subject.
    """
    return pd.Series(np.asarray(grades)).groupby(np.asarray(subjects)).max()


def sample_bootstrap_counts(worst: pd.Series, *, replicates: int, seed: int, stream: int) -> Array:
    """Sample how often each subject occurs in each bootstrap sample, stratified by grade.

    Parameters
    ----------
    worst : Series
        Grade of each subject, from `worst_grades`.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the study.
    stream : int
        Key of the random stream, combined with the seed.

    Returns
    -------
    (subjects, 1 + replicates) float array
        Number of times that each subject occurs in each sample; the first column is 1 for all subjects.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
    weights = np.ones((len(worst), 1 + replicates))
    for grade in sorted(set(worst)):
        members = np.flatnonzero(worst == grade)
        weights[members, 1:] = rng.multinomial(len(members), np.full(len(members), 1 / len(members)), replicates).T
    return weights


def sample_row_counts(predictions: pd.DataFrame, *, replicates: int, seed: int, stream: int) -> Array:
    """Sample how often each radiograph occurs in each bootstrap sample of the subjects, stratified by grade.

    Parameters
    ----------
    predictions : DataFrame
        One row per radiograph: subject, grade.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the study.
    stream : int
        Key of the random stream, combined with the seed.

    Returns
    -------
    (radiographs, 1 + replicates) float array
        Number of times that each radiograph occurs in each sample; the first column is 1 for all radiographs.
    """
    worst = worst_grades(predictions["subject"], predictions["grade"])
    weights = sample_bootstrap_counts(worst, replicates=replicates, seed=seed, stream=stream)
    return np.asarray(weights[worst.index.get_indexer(predictions["subject"])])
