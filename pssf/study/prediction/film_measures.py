"""Comparison of groups of measures on patient radiographs: joint space, radiomics and each texture measure.

Every group of measures yields one logistic regression, so that the groups can be compared. It is trained on simulated
radiographs, or on the patient radiographs themselves by cross-validation over subjects.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from ...core.checks import Array
from ...core.processes.worker_processes import limit_to_one_blas_thread
from ...radiomics.features.feature_families import FAMILIES, feature_family, split_area
from ...radiomics.features.feature_table import JSW_COLUMNS
from ..statistics.scores.metrics import percentile_interval, weighted_auc
from ..statistics.scores.subject_resampling import sample_row_counts

# Grades of patients that are compared with grade 0.
_GRADES = (2, 3, 4)
# Inverse strength of the L2 penalty; chosen in advance for features that outnumber the radiographs (assumed).
_PENALTY = 0.1
_FOLDS = 5
# Repetitions of the cross-validation, over which the probabilities are averaged.
_REPETITIONS = 4
# Key of the bootstrap random stream, combined with the seed of the study.
_STREAM = 2**31 + 2
JOINT_SPACE = "joint space"
COLUMNS = [
    *("measures", "features", "trained_on", "grade", "radiographs", "negatives", "positives"),
    *("auc", "auc_low", "auc_high"),
]


def score_film_measures(
    cohort: pd.DataFrame, films: pd.DataFrame, names: Sequence[str], *, replicates: int, seed: int
) -> pd.DataFrame:
    """Score groups of measures for grade 0 against each higher grade on patient radiographs.

    Parameters
    ----------
    cohort : DataFrame
        Displayed radiographs of the cohort with a located joint: grade and features.
    films : DataFrame
        Patient radiographs with a located joint and a known grade: subject, grade and features.
    names : sequence of str
        Names of the features.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the folds and of the bootstrap.

    Returns
    -------
    DataFrame
        One row per group of measures, training set and grade, with the columns `COLUMNS`. The intervals are computed
        from a bootstrap of subjects within each grade. A grade without radiographs, and a training set without the two
        grades, are omitted.
    """
    rows: list[dict[str, Any]] = []
    # The matrices are small: threads would take longer to start than one thread to compute.
    with limit_to_one_blas_thread():
        for grade in _GRADES:
            rows += _score_grade(cohort, films, names, grade, replicates, seed)
    return pd.DataFrame(rows, columns=COLUMNS)


def _score_grade(
    cohort: pd.DataFrame, films: pd.DataFrame, names: Sequence[str], grade: int, replicates: int, seed: int
) -> list[dict[str, Any]]:
    """Score all groups of measures for grade 0 against one higher grade."""
    of_films = films[films["grade"].isin((0, grade))].reset_index(drop=True)
    of_cohort = cohort[cohort["grade"].isin((0, grade))]
    truth = of_films["grade"].to_numpy() == grade
    rows: list[dict[str, Any]] = []
    if not 0 < truth.sum() < len(truth):
        return rows
    counts = sample_row_counts(of_films, replicates=replicates, seed=seed, stream=_STREAM)
    for label, group in _group_measures(names, films).items():
        for trained_on, value in _predict(of_cohort, of_films, group, grade, seed).items():
            drawn = weighted_auc(truth, value, counts)
            low, high = percentile_interval(drawn[1:])
            rows.append(
                {
                    "measures": label, "features": len(group), "trained_on": trained_on, "grade": grade,
                    "radiographs": len(truth), "negatives": int((~truth).sum()), "positives": int(truth.sum()),
                    "auc": drawn[0], "auc_low": low, "auc_high": high,
                }
            )  # fmt: skip
    return rows


def _group_measures(names: Sequence[str], films: pd.DataFrame) -> dict[str, list[str]]:
    """Group the measures: joint space, radiomics, each family of texture measures, and all with the joint space."""
    groups: dict[str, list[str]] = {}
    jsw = [name for name in JSW_COLUMNS if name in films]
    if jsw:
        groups[JOINT_SPACE] = jsw
    for name in names:
        family = feature_family(split_area(name)[0])
        groups.setdefault("radiomics" if family in FAMILIES else family, []).append(name)
    if jsw and names:
        groups[f"{JOINT_SPACE} and features"] = [*jsw, *names]
    return groups


def _predict(cohort: pd.DataFrame, films: pd.DataFrame, group: list[str], grade: int, seed: int) -> dict[str, Array]:
    """Predict the patient radiographs by a model of each training set; the name of the set is the key."""
    values: dict[str, Array] = {}
    truth = (films["grade"] == grade).to_numpy(np.int64)
    if cohort["grade"].nunique() == 2 and set(group) <= set(cohort.columns):
        model = _make_model().fit(cohort[group].to_numpy(), (cohort["grade"] == grade).to_numpy())
        values["simulation"] = model.decision_function(films[group].to_numpy())
    subjects = films["subject"].to_numpy()
    if min(len(set(subjects[truth == side])) for side in (0, 1)) >= _FOLDS:
        values["patients"] = _cross_validate(films[group].to_numpy(np.float64), truth, subjects, seed)
    return values


def _cross_validate(features: Array, truth: NDArray[np.int64], subjects: NDArray[Any], seed: int) -> Array:
    """Predict each radiograph by models of other subjects, and average over the repetitions."""
    total = np.zeros(len(truth))
    for repetition in range(_REPETITIONS):
        folds = StratifiedGroupKFold(_FOLDS, shuffle=True, random_state=(seed + repetition) % 2**32)
        for train, test in folds.split(features, truth, subjects):
            model = _make_model().fit(features[train], truth[train])
            # Values of several models are comparable if they are log odds.
            total[test] += model.decision_function(features[test])
    return total / _REPETITIONS


def _make_model() -> Pipeline:
    """Make a logistic regression on standardised features."""
    return make_pipeline(StandardScaler(), LogisticRegression(C=_PENALTY, class_weight="balanced", max_iter=2000))
