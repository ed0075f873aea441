"""Numbers of training subjects and features, and selected hyperparameter values."""

import pandas as pd

from ...design.classification_tasks import TASKS

_TRAINING_COLUMNS = ["task", "trained_on", "selection"]
_COLUMNS = [
    *_TRAINING_COLUMNS,
    "subjects",
    "features_measured",
    "features_offered",
    "features_selected",
    "subjects_per_feature",
]
_COUNT_COLUMNS = ("subjects", "features_measured", "features_offered", "features_selected")
_TUNING_COLUMNS = ["task", "trained_on", "model", "selection"]


def count_dimensions(
    importances: pd.DataFrame,
    selection_candidates: pd.DataFrame,
    subjects: pd.DataFrame,
    usable: pd.DataFrame,
    feature_count: int,
) -> pd.DataFrame:
    """Count features and training subjects in the split with the fewest training subjects per feature.

    Ten subjects per feature are a common minimum (Kocak 2024, METRICS item 16).

    Parameters
    ----------
    importances : DataFrame
        Importances of all splits: `ARM_COLUMNS` without ``tested_on``, repeat, feature.
    selection_candidates : DataFrame
        Features that remain after pruning, with the columns task, trained_on, selection, repeat and feature.
    subjects : DataFrame
        Columns repeat, subject and part (training, validation or test).
    usable : DataFrame
        Subject and grade of every radiograph.
    feature_count : int
        Number of measured features per radiograph.

    Returns
    -------
    DataFrame
        One row per task, training protocol and selection. subjects: number of training subjects with a
        grade of the task. features_measured, features_offered and features_selected: numbers of features that are
        measured, that remain after pruning (if known), and that are selected. subjects_per_feature: subjects per
        selected feature.
    """
    grades = usable.groupby("subject")["grade"].agg(set)
    training = subjects[subjects["part"] == "training"].groupby("repeat")["subject"].agg(list)
    rows = []
    for key, part in importances.groupby(_TRAINING_COLUMNS, sort=False):
        recipe = dict(zip(_TRAINING_COLUMNS, key, strict=True))
        wanted = set(sum(TASKS[recipe["task"]], ()))
        kept = part.groupby("repeat")["feature"].nunique()
        of_split = pd.DataFrame({"features_selected": kept})
        of_split["subjects"] = [sum(bool(grades[one] & wanted) for one in training[repeat]) for repeat in kept.index]
        of_split["subjects_per_feature"] = of_split["subjects"] / of_split["features_selected"]
        least = of_split["subjects_per_feature"].idxmin()
        pruned = selection_candidates[
            (selection_candidates[_TRAINING_COLUMNS] == pd.Series(recipe)).all(axis=1)
            & (selection_candidates["repeat"] == least)
        ]
        counts = {"features_measured": feature_count, "features_offered": len(pruned) or pd.NA}
        rows.append({**recipe, **of_split.loc[least].to_dict(), **counts})
    return pd.DataFrame(rows, columns=_COLUMNS).astype(dict.fromkeys(_COUNT_COLUMNS, "Int64"))


def count_tuned_values(tuning: pd.DataFrame) -> pd.DataFrame:
    """Count the splits in which each hyperparameter value was selected on the validation subjects.

    Parameters
    ----------
    tuning : DataFrame
        Hyperparameter values selected on all splits, from `SplitOutcome.tuning`.

    Returns
    -------
    DataFrame
        One row per task, training protocol, model, selection, hyperparameter and value, with the number of splits. The
        most frequent value comes first.
    """
    if tuning.empty:
        return pd.DataFrame(columns=[*_TUNING_COLUMNS, "parameter", "value", "splits"])
    counts = tuning.groupby([*_TUNING_COLUMNS, "parameter", "value"], sort=False)["repeat"].nunique()
    order = [True] * (len(_TUNING_COLUMNS) + 1) + [False, True]
    return counts.reset_index(name="splits").sort_values(
        [*_TUNING_COLUMNS, "parameter", "splits", "value"], ascending=order, ignore_index=True
    )
