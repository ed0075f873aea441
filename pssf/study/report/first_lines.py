"""What a reader should know who reads no further: the result in two sentences, and whether it can be one."""

import pandas as pd

from ..settings import MODELS
from ..statistics.tested import LEAST_OF_A_CLASS, LEAST_TESTED
from ..tasks import TASKS

_ARMS = {
    "within": "within one protocol",
    "cross": "on another protocol",
    "multi": "trained and tested on all protocols",
}
_VERDICTS = {"holds": "hold", "does not hold": "do not hold", "not decidable": "are not decidable here"}


def result_lines(scores: pd.DataFrame, claims: pd.DataFrame) -> list[str]:
    """The range of AUC over all models, none of them chosen, for the first task; how many claims hold.

    scores  of `scores.summarise`
    claims  of `claims.claims`
    """
    task = next((name for name in TASKS if (scores["task"] == name).any()), None)
    lines = []
    if task is not None:
        of_task = scores[(scores["task"] == task) & scores["model"].isin(list(MODELS)) & scores["auc"].notna()]
        arms = [line for line in (_arm(of_task, name) for name in _ARMS) if line]
        count = of_task[["model", "selection"]].drop_duplicates().shape[0]
        which = "of the model" if count == 1 else f"from the least to the best of {count} models"
        lines.append(
            f"Grade {task.replace('vs', 'against')}, AUC as the mean of the splits, {which}: {'; '.join(arms)}."
        )
    verdicts = claims["verdict"].value_counts()
    counted = [f"{verdicts.get(name, 0)} {what}" for name, what in _VERDICTS.items()]
    return [*lines, f"Of {len(claims)} measurements of what the paper claims {', '.join(counted)}."]


def few_tested(test_subjects: tuple[int, int], rarest: int) -> str:
    """A warning where splits test too few subjects for a result; "" where they do not.

    test_subjects  least and most of a split
    rarest         least of a split's class that has the fewest
    """
    least, most = test_subjects
    if least >= LEAST_TESTED and rarest >= LEAST_OF_A_CLASS:
        return ""
    tested = f"{least}" if least == most else f"{least} to {most}"
    return (
        f"A split tests {tested} subjects, of the rarest grade {rarest}, and below {LEAST_TESTED}, or below "
        f"{LEAST_OF_A_CLASS} of a grade, nothing is decided: these numbers show that the "
        "chain runs, and say nothing of how well grades can be told. A larger preset or more knees would."
    )


def _arm(scores: pd.DataFrame, scenario: str) -> str:
    """A scenario's range of AUC in words; "" where there is none."""
    part = scores[scores["scenario"] == scenario]
    if scenario == "multi":
        part = part[part["tested_on"] == "all"]
    if part.empty:
        return ""
    least, best = (f"{value:.2f}" for value in (part["auc"].min(), part["auc"].max()))
    return f"{_ARMS[scenario]} {least}" + ("" if least == best else f" to {best}")
