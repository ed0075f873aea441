"""Which features, and which families of features, the models lean on."""

import pandas as pd

from ..radiomics.features import FAMILIES, family


def by_feature(importances: pd.DataFrame, splits: int) -> pd.DataFrame:
    """model, selection, feature, share, chosen: mean share over all splits (0 where not chosen), how often chosen."""
    grouped = importances.groupby(["model", "selection", "feature"], sort=False)["share"]
    found = grouped.agg(share=lambda shares: shares.sum() / splits, chosen="count").reset_index()
    return found.sort_values(["model", "selection", "share"], ascending=[True, True, False], ignore_index=True)


def by_family(features: pd.DataFrame) -> pd.DataFrame:
    """(families, models) sum of the mean shares of `by_feature`; every family has a row."""
    summed = features.assign(family=features["feature"].map(family)).groupby(["family", "model"])["share"].sum()
    return summed.unstack("model").reindex(FAMILIES).fillna(0.0)
