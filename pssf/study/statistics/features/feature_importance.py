"""Importance of features and feature families, averaged over the splits."""

import pandas as pd

from ....radiomics.features.feature_families import ALL_FAMILIES, FAMILIES, feature_family
from ...design.study_settings import StudySettings

# Number of the most important features, which figures show individually.
_LEADING_COUNT = 5


def average_by_feature(importances: pd.DataFrame, splits: int, value: str = "importance") -> pd.DataFrame:
    """Average the importance of each feature over all splits; the importance is 0 on splits without the feature.

    Parameters
    ----------
    importances : DataFrame
        Importances of all splits: model, selection, feature and `value`.
    splits : int
        Number of splits.
    value : str, default "importance"
        Name of the column to average.

    Returns
    -------
    DataFrame
        Columns: model, selection, feature, `value`, and selection_frequency (number of splits that selected the
        feature).
    """
    columns = ["model", "selection", "feature", value]
    if importances.empty:
        return pd.DataFrame(columns=[*columns, "selection_frequency"])
    grouped = importances.groupby(columns[:3], sort=False)[value]
    means = grouped.agg(**{value: lambda values: values.sum() / splits, "selection_frequency": "count"}).reset_index()
    return means.sort_values(["model", "selection", value], ascending=[True, True, False], ignore_index=True)


def sum_by_family(features: pd.DataFrame, value: str = "importance") -> pd.DataFrame:
    """Sum the mean importances of each feature family.

    Parameters
    ----------
    features : DataFrame
        Table from `average_by_feature`.
    value : str, default "importance"
        Name of the column to sum.

    Returns
    -------
    DataFrame
        One row per family and one column per model; 0 for a family without features.
    """
    summed = features.assign(family=features["feature"].map(feature_family)).groupby(["family", "model"])[value].sum()
    by_model = summed.unstack("model")
    return by_model.reindex([name for name in ALL_FAMILIES if name in FAMILIES or name in by_model.index]).fillna(0.0)


def select_leading_features(features: pd.DataFrame, settings: StudySettings) -> list[str]:
    """Select the features with the largest mean importance over the models.

    Parameters
    ----------
    features : DataFrame
        Table from `average_by_feature`.
    settings : StudySettings
        Settings of the study; only the first feature selection is used.

    Returns
    -------
    list of str
        Names of at most five features.
    """
    part = features[features["selection"] == settings.selections[0]]
    means = part.groupby("feature")["importance"].sum().sort_values(ascending=False, kind="stable")
    return [str(name) for name in means.index[:_LEADING_COUNT]]
