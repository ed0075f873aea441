"""Summary of the report: the main result in two sentences, and the reason if no claim is decided."""

import pandas as pd

from ..design.classification_tasks import TASKS
from ..design.study_settings import MODELS
from ..statistics.scores.claims import UNDECIDED
from ..statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS

_SCENARIO_PHRASES = {
    "within": "within one protocol",
    "cross": "on another protocol",
    "multi": "trained and tested on all protocols",
}
_VERDICT_PHRASES = {
    "holds": "hold",
    "does not hold": "do not hold",
    "not decidable": "are not decidable with this cohort",
}


def summarise_results(scores: pd.DataFrame, claims: pd.DataFrame) -> list[str]:
    """Summarise the range of AUC over all models for the first task, and the verdicts on the claims.

    The summary reports the range over all models, because a selection of the best model by its test result would be
    biased.

    Parameters
    ----------
    scores : DataFrame
        Table from `split_scores.summarise_scores`.
    claims : DataFrame
        Table from `claims.evaluate_claims`.

    Returns
    -------
    list of str
        Sentences of the summary.
    """
    task = next((name for name in TASKS if (scores["task"] == name).any()), None)
    lines = []
    if task is not None:
        of_task = scores[(scores["task"] == task) & scores["model"].isin(list(MODELS)) & scores["auc"].notna()]
        arms = [line for line in (_format_auc_range(of_task, name) for name in _SCENARIO_PHRASES) if line]
        count = of_task[["model", "selection"]].drop_duplicates().shape[0]
        which = "one model" if count == 1 else f"range over {count} models"
        lines.append(f"AUC for grade {task}, mean over the splits, {which}: {'; '.join(arms)}.")
    verdicts = claims["verdict"].value_counts()
    counted = [f"{verdicts.get(name, 0)} {what}" for name, what in _VERDICT_PHRASES.items()]
    return [*lines, f"Of {len(claims)} measures of the published claims, {', '.join(counted)}."]


def explain_undecided_run(
    claims: pd.DataFrame, subjects: int, test_subjects: tuple[int, int], rarest_class_subjects: int
) -> str:
    """Explain in one sentence why no claim, or no claim about a model, is decided.

    Parameters
    ----------
    claims : DataFrame
        Table from `claims.evaluate_claims`.
    subjects : int
        Number of subjects in the cohort.
    test_subjects : tuple of int
        Smallest and largest number of test subjects per split.
    rarest_class_subjects : int
        Smallest number of test subjects of a class.

    Returns
    -------
    str
        Sentence; "" if a claim is decided and there are enough test subjects.
    """
    least, most = test_subjects
    undecided = bool((claims["verdict"] == UNDECIDED).all())
    if least >= MIN_TEST_SUBJECTS and rarest_class_subjects >= MIN_TEST_SUBJECTS_PER_CLASS:
        return f"With {subjects} subjects no claim is decided; the intervals are too wide." if undecided else ""
    tested = f"{least}" if least == most else f"{least} to {most}"
    what = "no claim" if undecided else "no claim about a model"
    return (
        f"With {subjects} subjects {what} is decided; a split has {tested} test subjects "
        f"({rarest_class_subjects} of the rarest grade), and a decision needs {MIN_TEST_SUBJECTS} "
        f"({MIN_TEST_SUBJECTS_PER_CLASS} of each grade)."
    )


def _format_auc_range(scores: pd.DataFrame, scenario: str) -> str:
    """Format the range of AUC in a scenario; "" without results."""
    part = scores[scores["scenario"] == scenario]
    if scenario == "multi":
        part = part[part["tested_on"] == "all"]
    if part.empty:
        return ""
    least, best = (f"{value:.2f}" for value in (part["auc"].min(), part["auc"].max()))
    return f"{_SCENARIO_PHRASES[scenario]} {least}" + ("" if least == best else f" to {best}")
