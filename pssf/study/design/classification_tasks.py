"""Kellgren-Lawrence grades, and the classification tasks between grades."""

from collections.abc import Iterable

from ...core.checks import InputError

# Grade names after Kellgren and Lawrence 1957; the grades of simulated knees approximate KL grades.
GRADE_NAMES = {"0": "normal", "1": "doubtful OA", "2": "mild OA", "3": "moderate OA", "4": "severe OA"}
# Grades in each class of a classification task.
Classes = tuple[tuple[int, ...], ...]
TASKS: dict[str, Classes] = {
    "0 vs 2": ((0,), (2,)),
    "0/1/2": ((0,), (1,), (2,)),
    "0 vs 3+4": ((0,), (3, 4)),
    "0/1/2/3/4": ((0,), (1,), (2,), (3,), (4,)),
}
# Classification tasks with more than two classes, in order of the number of classes.
MULTICLASS_TASKS = {name: classes for name, classes in TASKS.items() if len(classes) > 2}


def find_tasks(grades: Iterable[int]) -> dict[str, Classes]:
    """Find the classification tasks for which each class has at least one of the available grades.

    Parameters
    ----------
    grades : iterable of int
        KL grades in the data.

    Returns
    -------
    dict of str to Classes
        Grades of each class, keyed by task name.
    """
    present = set(grades)
    return {task: classes for task, classes in TASKS.items() if all(present & set(one) for one in classes)}


def select_contrast(grades: Iterable[int]) -> str:
    """Select the two-class task that contains the most severe of the available grades.

    Parameters
    ----------
    grades : iterable of int
        KL grades in the data.

    Returns
    -------
    str
        Name of the task.

    Raises
    ------
    InputError
        The grades allow no two-class task.
    """
    allowed = [task for task, classes in find_tasks(grades).items() if len(classes) == 2]
    if not allowed:
        present = ", ".join(map(str, sorted(set(grades))))
        raise InputError(f"grades must include 0 and at least one of 2, 3 and 4, got {present}")
    return allowed[-1]


def lowest_grades(task: str) -> tuple[int, ...]:
    """Find the lowest grade of each class in a task; this grade labels the class in tables.

    Parameters
    ----------
    task : str
        Name of the task.

    Returns
    -------
    tuple of int
        Lowest grade of each class.
    """
    return tuple(min(one) for one in TASKS[task])


def class_names(task: str) -> tuple[str, ...]:
    """Describe each class of a classification task in words.

    Parameters
    ----------
    task : str
        Name of the task.

    Returns
    -------
    tuple of str
        Names such as "normal" or "moderate OA or severe OA".
    """
    return tuple(" or ".join(GRADE_NAMES[str(grade)] for grade in one) for one in TASKS[task])
