"""Grades, and the tasks that a study has of them: which are told from which."""

from collections.abc import Iterable

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
