"""How well models do in women and men, and in younger and older subjects: grade 0 against 2, within protocol."""

from collections.abc import Iterable
from typing import Any

import pandas as pd

from ..predictions import truth_and_probability
from ..settings import StudySettings
from .intervals import bounds
from .metrics import METRICS, score
from .tested import count_tested, enough

COLUMNS = ["model", "selection", "group", "subjects", *(f"{m}{end}" for m in METRICS for end in ("", "_low", "_high"))]


def subgroups(
    predictions: pd.DataFrame, parameters: pd.DataFrame, settings: StudySettings, ratio: float
) -> pd.DataFrame:
    """One row a model, selection and group: COLUMNS; means over the splits, 95 % intervals from them.

    A split whose test part has not both grades in a group gives nothing there; where splits, in the median, do not test
    `enough` subjects of a group, it has no interval.

    predictions  of all splits
    parameters   of `parameters.parameters_of`; without sex and age there are no groups
    ratio        of `intervals.share_tested`
    """
    part = predictions[(predictions["task"] == "0 vs 2") & (predictions["scenario"] == "within")]
    part = part[part["selection"].isin(settings.selections)]
    rows = []
    if len(part):
        for (model, selection), of_arm in part.groupby(["model", "selection"], sort=False):
            for group, subjects in _groups(parameters).items():
                inside = of_arm[of_arm["subject"].isin(subjects)]
                row = {"model": model, "selection": selection, "group": group, "subjects": inside["subject"].nunique()}
                rows.append(row | _scores(inside, of_arm["repeat"].unique(), ratio))
    return pd.DataFrame(rows, columns=COLUMNS)


def _groups(parameters: pd.DataFrame) -> dict[str, set[Any]]:
    """group -> its subjects"""
    people, chosen = parameters.drop_duplicates("subject"), dict[str, pd.Series]()
    if "female" in people:
        chosen |= {"women": people["female"] > 0, "men": people["female"] == 0}
    if "age_years" in people:
        middle = people["age_years"].median()
        chosen |= {f"up to {middle:.0f} years": people["age_years"] <= middle}
        chosen |= {f"over {middle:.0f} years": people["age_years"] > middle}
    return {name: set(people["subject"][inside]) for name, inside in chosen.items()}


def _scores(inside: pd.DataFrame, repeats: Iterable[Any], ratio: float) -> dict[str, float]:
    of_splits = [score(*truth_and_probability(split)) for _, split in inside.groupby("repeat", sort=False)]
    table = pd.DataFrame(of_splits, columns=list(METRICS))
    means = {metric: float(table[metric].mean()) for metric in METRICS}
    # Of fewer that are tested an interval may have no width, and holds nothing.
    tested = (inside[inside["repeat"] == repeat] for repeat in repeats)
    counts = [count_tested(split["subject"], split["truth"], range(2)) for split in tested]
    return means | (bounds(table, ratio) if enough(pd.DataFrame(counts).median()) else {})
