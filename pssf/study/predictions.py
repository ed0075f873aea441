"""The form in which predictions go from training to statistics. An arm: fitted on what, tested on what."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.checks import InputError

# Kellgren and Lawrence 1957; those of simulated knees are like them.
GRADES = {"0": "normal", "1": "doubtful OA", "2": "mild OA", "3": "moderate OA", "4": "severe OA"}
# Task -> the grades of each of its classes.
Classes = tuple[tuple[int, ...], ...]
TASKS: dict[str, Classes] = {
    "0 vs 2": ((0,), (2,)),
    "0/1/2": ((0,), (1,), (2,)),
    "0 vs 3+4": ((0,), (3, 4)),
    "0/1/2/3/4": ((0,), (1,), (2,), (3,), (4,)),
}
# Those of more than two classes, the fewest first.
GRADED = {name: classes for name, classes in TASKS.items() if len(classes) > 2}
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


def tasks_of(grades: Iterable[int]) -> dict[str, Classes]:
    """Those of TASKS each of whose classes has one of these grades."""
    present = set(grades)
    return {task: classes for task, classes in TASKS.items() if all(present & set(one) for one in classes)}


def contrast_of(grades: Iterable[int]) -> str:
    """Task of two classes that has the worst of these grades: what is asked of a model where only one task is.

    raises  InputError for grades that allow none
    """
    allowed = [task for task, classes in tasks_of(grades).items() if len(classes) == 2]
    if not allowed:
        present = ", ".join(map(str, sorted(set(grades))))
        raise InputError(f"grades = {present}; allowed: 0 and, of 2, 3 and 4, one or more")
    return allowed[-1]


def least_grades(task: str) -> tuple[int, ...]:
    """The least grade of each class of a task, by which it is called."""
    return tuple(min(one) for one in TASKS[task])


def class_names(task: str) -> tuple[str, ...]:
    """Each class of a task in words."""
    return tuple(" or ".join(GRADES[str(grade)] for grade in one) for one in TASKS[task])


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
