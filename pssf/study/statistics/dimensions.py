"""How many features the models keep, against how many subjects they learn from; and which parameters were chosen."""

import pandas as pd

from ..tasks import TASKS

_RECIPE = ["task", "trained_on", "selection"]
_COLUMNS = [*_RECIPE, "subjects", "measured", "offered", "kept", "subjects_per_feature"]
_COUNTS = ("subjects", "measured", "offered", "kept")
_ARM = ["task", "trained_on", "model", "selection"]


def dimensions(
    importances: pd.DataFrame, offered: pd.DataFrame, subjects: pd.DataFrame, usable: pd.DataFrame, measured: int
) -> pd.DataFrame:
    """One row a task, protocol and selection, of the split that has the fewest subjects a feature.

    importances  ARM without `tested_on`, repeat, feature
    offered      task, trained_on, selection, repeat, feature: what pruning left to select from
    subjects     repeat, subject, part
    usable       subject, grade of every radiograph
    measured     features of a radiograph
    returns      training subjects of the task's grades; features measured, that a selection was offered, where that is
                 known, and that it kept; subjects a feature. Ten subjects a feature are a common least (Kocak 2024,
                 METRICS 16)
    """
    grades = usable.groupby("subject")["grade"].agg(set)
    training = subjects[subjects["part"] == "training"].groupby("repeat")["subject"].agg(list)
    rows = []
    for key, part in importances.groupby(_RECIPE, sort=False):
        recipe = dict(zip(_RECIPE, key, strict=True))
        wanted = set(sum(TASKS[recipe["task"]], ()))
        kept = part.groupby("repeat")["feature"].nunique()
        of_split = pd.DataFrame({"kept": kept})
        of_split["subjects"] = [sum(bool(grades[one] & wanted) for one in training[repeat]) for repeat in kept.index]
        of_split["subjects_per_feature"] = of_split["subjects"] / of_split["kept"]
        least = of_split["subjects_per_feature"].idxmin()
        pruned = offered[(offered[_RECIPE] == pd.Series(recipe)).all(axis=1) & (offered["repeat"] == least)]
        counts = {"measured": measured, "offered": len(pruned) or pd.NA}
        rows.append({**recipe, **of_split.loc[least].to_dict(), **counts})
    return pd.DataFrame(rows, columns=_COLUMNS).astype(dict.fromkeys(_COUNTS, "Int64"))


def tuned(chosen: pd.DataFrame) -> pd.DataFrame:
    """How often the validation subjects chose a value: a row an arm, parameter and value, the most frequent first.

    chosen  of `Outcome.tuning`
    """
    if chosen.empty:
        return pd.DataFrame(columns=[*_ARM, "parameter", "value", "splits"])
    counts = chosen.groupby([*_ARM, "parameter", "value"], sort=False)["repeat"].nunique()
    order = [True] * (len(_ARM) + 1) + [False, True]
    return counts.reset_index(name="splits").sort_values(
        [*_ARM, "parameter", "splits", "value"], ascending=order, ignore_index=True
    )
