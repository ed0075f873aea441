"""Importance of features and feature families, averaged over the splits."""

import pandas as pd

from ....radiomics.features.feature_families import FAMILIES, feature_family
from ...design.study_settings import StudySettings

# Number of leading features that figures show one by one.
_LEADING_COUNT = 5


def average_by_feature(importances: pd.DataFrame, splits: int, value: str = "share") -> pd.DataFrame:
    """Average the importance of each feature over all splits; a split that did not select it counts as 0.

    Parameters
    ----------
    importances : DataFrame
        Importances of all splits: model, selection, feature and `value`.
    splits : int
        Number of splits.
    value : str, default "share"
        Column to average.

    Returns
    -------
    DataFrame
        Columns: model, selection, feature, `value`, and chosen (number of splits that selected it).
    """
    columns = ["model", "selection", "feature", value]
    if importances.empty:
        return pd.DataFrame(columns=[*columns, "chosen"])
    grouped = importances.groupby(columns[:3], sort=False)[value]
    means = grouped.agg(**{value: lambda values: values.sum() / splits, "chosen": "count"}).reset_index()
    return means.sort_values(["model", "selection", value], ascending=[True, True, False], ignore_index=True)


def sum_by_family(features: pd.DataFrame, value: str = "share") -> pd.DataFrame:
    """Sum the mean importances of each feature family.

    Parameters
    ----------
    features : DataFrame
        Table of `average_by_feature`.
    value : str, default "share"
        Column to sum.

    Returns
    -------
    DataFrame
        One row per family and one column per model; 0 for a family without features.
    """
    summed = features.assign(family=features["feature"].map(feature_family)).groupby(["family", "model"])[value].sum()
    return summed.unstack("model").reindex(FAMILIES).fillna(0.0)


def select_leading_features(features: pd.DataFrame, settings: StudySettings) -> list[str]:
    """Select the features with the largest mean importance over the models.

    Parameters
    ----------
    features : DataFrame
        Table of `average_by_feature`.
    settings : StudySettings
        Settings; the first selection is used.

    Returns
    -------
    list of str
        Names of at most five features.
    """
    part = features[features["selection"] == settings.selections[0]]
    means = part.groupby("feature")["share"].sum().sort_values(ascending=False, kind="stable")
    return [str(name) for name in means.index[:_LEADING_COUNT]]
