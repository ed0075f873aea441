"""Which features, and which families of features, the models lean on: means over the splits."""

import pandas as pd

from ...radiomics.families import FAMILIES, family
from ..settings import StudySettings

_LEADING = 5  # that are drawn one by one


def by_feature(importances: pd.DataFrame, splits: int, value: str = "share") -> pd.DataFrame:
    """model, selection, feature, `value`, chosen: mean over all splits (0 where not chosen), how often chosen."""
    columns = ["model", "selection", "feature", value]
    if importances.empty:
        return pd.DataFrame(columns=[*columns, "chosen"])
    grouped = importances.groupby(columns[:3], sort=False)[value]
    means = grouped.agg(**{value: lambda values: values.sum() / splits, "chosen": "count"}).reset_index()
    return means.sort_values(["model", "selection", value], ascending=[True, True, False], ignore_index=True)


def by_family(features: pd.DataFrame, value: str = "share") -> pd.DataFrame:
    """(families, models) sum of the means of `by_feature`; every family has a row."""
    summed = features.assign(family=features["feature"].map(family)).groupby(["family", "model"])[value].sum()
    return summed.unstack("model").reindex(FAMILIES).fillna(0.0)


def leading(features: pd.DataFrame, settings: StudySettings) -> list[str]:
    """Of `by_feature`, those of the first selection with the largest mean share over the models."""
    part = features[features["selection"] == settings.selections[0]]
    means = part.groupby("feature")["share"].sum().sort_values(ascending=False, kind="stable")
    return [str(name) for name in means.index[:_LEADING]]
