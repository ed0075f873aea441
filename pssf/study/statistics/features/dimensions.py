"""Numbers of selected features and training subjects, and the chosen hyperparameters."""

import pandas as pd

from ...design.classification_tasks import TASKS

_TRAINING_COLUMNS = ["task", "trained_on", "selection"]
_COLUMNS = [*_TRAINING_COLUMNS, "subjects", "measured", "offered", "kept", "subjects_per_feature"]
_COUNT_COLUMNS = ("subjects", "measured", "offered", "kept")
_TUNING_COLUMNS = ["task", "trained_on", "model", "selection"]


def count_dimensions(
    importances: pd.DataFrame,
    selection_candidates: pd.DataFrame,
    subjects: pd.DataFrame,
    usable: pd.DataFrame,
    feature_count: int,
) -> pd.DataFrame:
    """Count features and training subjects of each training, on the split with the fewest subjects per feature.

    Ten subjects per feature are a common minimum (Kocak 2024, METRICS item 16).

    Parameters
    ----------
    importances : DataFrame
        Importances of all splits: `ARM_COLUMNS` without ``tested_on``, repeat, feature.
    selection_candidates : DataFrame
        Features left after pruning: task, trained_on, selection, repeat, feature.
    subjects : DataFrame
        Part of each subject: repeat, subject, part.
    usable : DataFrame
        Subject and grade of every radiograph.
    feature_count : int
        Number of measured features per radiograph.

    Returns
    -------
    DataFrame
        One row per task, training protocol and selection. subjects: training subjects of the grades of the task.
        measured, offered and kept: features measured, offered to the selection (if known) and selected.
        subjects_per_feature: subjects per selected feature.
    """
    grades = usable.groupby("subject")["grade"].agg(set)
    training = subjects[subjects["part"] == "training"].groupby("repeat")["subject"].agg(list)
    rows = []
    for key, part in importances.groupby(_TRAINING_COLUMNS, sort=False):
        recipe = dict(zip(_TRAINING_COLUMNS, key, strict=True))
        wanted = set(sum(TASKS[recipe["task"]], ()))
        kept = part.groupby("repeat")["feature"].nunique()
        of_split = pd.DataFrame({"kept": kept})
        of_split["subjects"] = [sum(bool(grades[one] & wanted) for one in training[repeat]) for repeat in kept.index]
        of_split["subjects_per_feature"] = of_split["subjects"] / of_split["kept"]
        least = of_split["subjects_per_feature"].idxmin()
        pruned = selection_candidates[
            (selection_candidates[_TRAINING_COLUMNS] == pd.Series(recipe)).all(axis=1)
            & (selection_candidates["repeat"] == least)
        ]
        counts = {"measured": feature_count, "offered": len(pruned) or pd.NA}
        rows.append({**recipe, **of_split.loc[least].to_dict(), **counts})
    return pd.DataFrame(rows, columns=_COLUMNS).astype(dict.fromkeys(_COUNT_COLUMNS, "Int64"))


def count_tuned_values(tuning: pd.DataFrame) -> pd.DataFrame:
    """Count how often the validation subjects chose each value of a hyperparameter.

    Parameters
    ----------
    tuning : DataFrame
        Chosen values of all splits, of `SplitOutcome.tuning`.

    Returns
    -------
    DataFrame
        One row per arm, hyperparameter and value, the most frequent first, with the number of splits.
    """
    if tuning.empty:
        return pd.DataFrame(columns=[*_TUNING_COLUMNS, "parameter", "value", "splits"])
    counts = tuning.groupby([*_TUNING_COLUMNS, "parameter", "value"], sort=False)["repeat"].nunique()
    order = [True] * (len(_TUNING_COLUMNS) + 1) + [False, True]
    return counts.reset_index(name="splits").sort_values(
        [*_TUNING_COLUMNS, "parameter", "splits", "value"], ascending=order, ignore_index=True
    )
