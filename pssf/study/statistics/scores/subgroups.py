"""Scores for women, men, younger and older subjects: grade 0 vs 2, within-protocol scenario."""

from collections.abc import Iterable
from typing import Any

import pandas as pd

from ...design.study_settings import StudySettings
from ...predictions import extract_truth_and_probability
from .confidence_intervals import compute_metric_intervals
from .metrics import METRICS, score_predictions
from .tested_subjects import count_test_subjects, has_enough_test_subjects

COLUMNS = ["model", "selection", "group", "subjects", *(f"{m}{end}" for m in METRICS for end in ("", "_low", "_high"))]


def score_subgroups(
    predictions: pd.DataFrame, parameters: pd.DataFrame, settings: StudySettings, ratio: float
) -> pd.DataFrame:
    """Score the predictions of each model within each subgroup.

    The scores are means over the splits. A split is omitted for a subgroup if its test subjects in the subgroup do not
    include both grades. A subgroup has no interval if its median number of test subjects is too small.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all splits.
    parameters : DataFrame
        Knee parameters, from `extract_knee_parameters`; without sex and age there are no subgroups.
    settings : StudySettings
        Settings of the study; only models with a feature selection in the settings are scored, not the baselines.
    ratio : float
        Ratio of test to training subjects.

    Returns
    -------
    DataFrame
        One row per model, selection and group, with the columns `COLUMNS`.
    """
    part = predictions[(predictions["task"] == "0 vs 2") & (predictions["scenario"] == "within")]
    part = part[part["selection"].isin(settings.selections)]
    rows = []
    if len(part):
        for (model, selection), of_arm in part.groupby(["model", "selection"], sort=False):
            for group, subjects in _find_groups(parameters).items():
                inside = of_arm[of_arm["subject"].isin(subjects)]
                row = {"model": model, "selection": selection, "group": group, "subjects": inside["subject"].nunique()}
                rows.append(row | _score_group(inside, of_arm["repeat"].unique(), ratio))
    return pd.DataFrame(rows, columns=COLUMNS)


def _find_groups(parameters: pd.DataFrame) -> dict[str, set[Any]]:
    """Find the subjects of each subgroup: women, men, subjects up to the median age, and older subjects."""
    people, chosen = parameters.drop_duplicates("subject"), dict[str, pd.Series]()
    if "female" in people:
        chosen |= {"women": people["female"] > 0, "men": people["female"] == 0}
    if "age_years" in people:
        middle = people["age_years"].median()
        chosen |= {f"up to {middle:.0f} years": people["age_years"] <= middle}
        chosen |= {f"over {middle:.0f} years": people["age_years"] > middle}
    return {name: set(people["subject"][inside]) for name, inside in chosen.items()}


def _score_group(inside: pd.DataFrame, repeats: Iterable[Any], ratio: float) -> dict[str, float]:
    """Average the scores of one subgroup over the splits and compute intervals."""
    of_splits = [
        score_predictions(*extract_truth_and_probability(split)) for _, split in inside.groupby("repeat", sort=False)
    ]
    table = pd.DataFrame(of_splits, columns=list(METRICS))
    means = {metric: float(table[metric].mean()) for metric in METRICS}
    # With too few test subjects, an interval may have no width and would not contain the true value.
    tested = (inside[inside["repeat"] == repeat] for repeat in repeats)
    counts = [count_test_subjects(split["subject"], split["truth"], range(2)) for split in tested]
    return means | (
        compute_metric_intervals(table, ratio) if has_enough_test_subjects(pd.DataFrame(counts).median()) else {}
    )
