"""Summary of the report: the main result in two sentences, and a warning if the cohort is too small."""

import pandas as pd

from ..design.classification_tasks import TASKS
from ..design.study_settings import MODELS
from ..statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS

_SCENARIO_PHRASES = {
    "within": "within one protocol",
    "cross": "on another protocol",
    "multi": "trained and tested on all protocols",
}
_VERDICT_PHRASES = {"holds": "hold", "does not hold": "do not hold", "not decidable": "are not decidable here"}


def summarise_results(scores: pd.DataFrame, claims: pd.DataFrame) -> list[str]:
    """Summarise the range of AUC over all models for the first task, and the verdicts on the claims.

    No model is chosen by its result.

    Parameters
    ----------
    scores : DataFrame
        Table of `split_scores.summarise_scores`.
    claims : DataFrame
        Table of `claims.evaluate_claims`.

    Returns
    -------
    list of str
        Sentences.
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
    return [*lines, f"Of {len(claims)} measurements of the claims of the paper, {', '.join(counted)}."]


def format_sample_size_warning(test_subjects: tuple[int, int], rarest_class_subjects: int) -> str:
    """Warn if the splits test too few subjects for a result.

    Parameters
    ----------
    test_subjects : tuple of int
        Smallest and largest number of test subjects of a split.
    rarest_class_subjects : int
        Smallest number of test subjects of a class.

    Returns
    -------
    str
        Warning; "" if there are enough subjects.
    """
    least, most = test_subjects
    if least >= MIN_TEST_SUBJECTS and rarest_class_subjects >= MIN_TEST_SUBJECTS_PER_CLASS:
        return ""
    tested = f"{least}" if least == most else f"{least} to {most}"
    return (
        f"A split tests {tested} subjects, {rarest_class_subjects} of the rarest grade. With fewer than "
        f"{MIN_TEST_SUBJECTS} subjects, or fewer than {MIN_TEST_SUBJECTS_PER_CLASS} of a grade, no claim is decided. "
        "These numbers show that the software runs, but not how well grades can be predicted. Use a larger preset or "
        "more knees."
    )


def _format_auc_range(scores: pd.DataFrame, scenario: str) -> str:
    """Format the range of AUC of a scenario; "" if there is none."""
    part = scores[scores["scenario"] == scenario]
    if scenario == "multi":
        part = part[part["tested_on"] == "all"]
    if part.empty:
        return ""
    least, best = (f"{value:.2f}" for value in (part["auc"].min(), part["auc"].max()))
    return f"{_SCENARIO_PHRASES[scenario]} {least}" + ("" if least == best else f" to {best}")
