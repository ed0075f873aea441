"""Which features, and which families of features, the models lean on."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.inspection import permutation_importance
from sklearn.pipeline import Pipeline

from ...radiomics import FAMILIES
from ...radiomics.features import family

_TURNS = 5


def by_feature(importances: pd.DataFrame, splits: int, value: str = "share") -> pd.DataFrame:
    """model, selection, feature, `value`, chosen: mean over all splits (0 where not chosen), how often chosen."""
    columns = ["model", "selection", "feature", value]
    if importances.empty:
        return pd.DataFrame(columns=[*columns, "chosen"])
    grouped = importances.groupby(columns[:3], sort=False)[value]
    found = grouped.agg(**{value: lambda values: values.sum() / splits, "chosen": "count"}).reset_index()
    return found.sort_values(["model", "selection", value], ascending=[True, True, False], ignore_index=True)


def by_family(features: pd.DataFrame, value: str = "share") -> pd.DataFrame:
    """(families, models) sum of the means of `by_feature`; every family has a row."""
    summed = features.assign(family=features["feature"].map(family)).groupby(["family", "model"])[value].sum()
    return summed.unstack("model").reindex(FAMILIES).fillna(0.0)


def permuted(pipeline: Pipeline, features: pd.DataFrame, truth: NDArray[np.int64], *, seed: int) -> dict[str, float]:
    """Feature -> by how much the AUC of a test part falls when the feature is shuffled between radiographs.

    Mean of five shuffles (Breiman 2001); of the features that the model was given, the others change nothing.

    features  (rows, features) of the test part
    truth     (rows,) 0 or 1; without both, nothing is found
    """
    if len(set(truth)) < 2:
        return {}
    kept = pipeline[:-1].transform(features)
    found = permutation_importance(
        pipeline[-1], kept, truth, scoring="roc_auc", n_repeats=_TURNS, random_state=seed % 2**32, n_jobs=1
    )
    return dict(zip(pipeline.named_steps["select"].kept_, found["importances_mean"].tolist(), strict=True))
