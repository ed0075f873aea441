"""The form in which predictions go from training to statistics. An arm: fitted on what, tested on what."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .tasks import TASKS, Classes

ARM = ["task", "scenario", "trained_on", "tested_on", "model", "selection"]
# What a model of the image must do better than, as further models of an arm; their selection is NONE.
BASELINES = {"chance": "Chance", "body": "Age, sex, stature", "jsw": "JSW (true)"}
NONE = "none"


@dataclass(frozen=True)
class Outcome:
    """Of one split.

    predictions  ARM, repeat, radiograph, knee, subject, protocol, truth (class index), p0, p1 and so on, one a class
    importances  ARM without `tested_on`, repeat, feature, share
    offered      task, trained_on, selection, repeat, feature: what pruning left to select from
    permutation  model, selection, repeat, feature, drop: within protocol, 0 vs 2
    tuning       task, trained_on, model, selection, repeat, parameter, value: what the validation subjects chose
    stable       how many features were stable across protocols in the training subjects; None with one protocol
    subjects     repeat, subject, part
    """

    predictions: pd.DataFrame
    importances: pd.DataFrame
    offered: pd.DataFrame
    permutation: pd.DataFrame
    tuning: pd.DataFrame
    stable: int | None
    subjects: pd.DataFrame


def class_of(grades: NDArray[np.int64], classes: Classes) -> NDArray[np.int64]:
    """(rows,) class index of grades that the classes have.

    grades  (rows,)
    """
    index = {grade: place for place, one in enumerate(classes) for grade in one}
    return np.array([index[int(grade)] for grade in grades], np.int64)


def truth_and_probability(predictions: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(rows,) class index and (rows, classes) probability of predictions of one task."""
    columns = [f"p{k}" for k in range(len(TASKS[predictions["task"].iloc[0]]))]
    # Column by column: a table of a few columns took four times as long as its values.
    probability = np.array([predictions[column].to_numpy(np.float64) for column in columns]).T
    return predictions["truth"].to_numpy(np.int64), probability


def joined(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """The tables one below the other."""
    return pd.concat(tables, ignore_index=True)
