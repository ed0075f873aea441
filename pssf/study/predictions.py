"""Prediction tables, passed from training to statistics.

An arm is one combination of task, scenario, training protocols, test protocols, model and feature selection.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .design.classification_tasks import TASKS, Classes

ARM_COLUMNS = ["task", "scenario", "trained_on", "tested_on", "model", "selection"]
# Label of each baseline that an image model must outperform, keyed by its name in the column ``model``. The column
# ``selection`` of a baseline is "none".
BASELINES = {"chance": "Chance", "body": "Age, sex, stature", "jsw": "JSW (true)"}
NO_SELECTION = "none"


@dataclass(frozen=True)
class SplitOutcome:
    """Predictions and tables from one split of the subjects.

    Attributes
    ----------
    predictions : DataFrame
        Columns `ARM_COLUMNS`, repeat, radiograph, knee, subject, protocol, truth (class index), and the probability of
        each class (p0, p1 and so on).
    importances : DataFrame
        Columns `ARM_COLUMNS` without ``tested_on``, repeat, feature, importance.
    selection_candidates : DataFrame
        Features after pruning, from which a feature selection selects: task, trained_on, selection, repeat, feature.
    permutation : DataFrame
        Permutation importance in the within-protocol scenario for grade 0 vs 2: model, selection, repeat, feature,
        drop.
    tuning : DataFrame
        Hyperparameters selected with the validation subjects: task, trained_on, model, selection, repeat, parameter,
        value.
    stable_feature_count : int or None
        Number of features that are stable across protocols in the training subjects; None if there is only one
        protocol.
    subjects : DataFrame
        Columns repeat, subject and part (training, validation or test).
    """

    predictions: pd.DataFrame
    importances: pd.DataFrame
    selection_candidates: pd.DataFrame
    permutation: pd.DataFrame
    tuning: pd.DataFrame
    stable_feature_count: int | None
    subjects: pd.DataFrame


def find_class_indices(grades: NDArray[np.int64], classes: Classes) -> NDArray[np.int64]:
    """Convert grades to class indices.

    Parameters
    ----------
    grades : (rows,) int64 array
        Grade of each row; every grade must belong to a class.
    classes : tuple of tuple of int
        Grades in each class.

    Returns
    -------
    (rows,) int64 array
        Class index of each row.
    """
    index = {grade: place for place, one in enumerate(classes) for grade in one}
    return np.array([index[int(grade)] for grade in grades], np.int64)


def extract_truth_and_probability(predictions: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Extract true classes and predicted probabilities.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of one task.

    Returns
    -------
    truth : (rows,) int64 array
        True class index.
    probability : (rows, classes) float64 array
        Predicted probability of each class.
    """
    columns = [f"p{k}" for k in range(len(TASKS[predictions["task"].iloc[0]]))]
    # Columns are converted one by one, which is four times as fast as conversion of the table.
    probability = np.array([predictions[column].to_numpy(np.float64) for column in columns]).T
    return predictions["truth"].to_numpy(np.int64), probability


def concatenate_tables(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Concatenate tables vertically and renumber the rows.

    Parameters
    ----------
    tables : iterable of DataFrame
        Tables to concatenate, in order.

    Returns
    -------
    DataFrame
        Rows of all tables.
    """
    return pd.concat(tables, ignore_index=True)
