"""Predictions scored split by split, and summarised arm by arm."""

import pandas as pd

from ..predictions import ARM, truth_and_probability
from .metrics import METRICS, score
from .tested import TESTED, count_tested


def score_splits(predictions: pd.DataFrame) -> pd.DataFrame:
    """ARM, repeat, the METRICS, TESTED and the radiographs tested: one row a split."""
    rows = []
    for key, part in predictions.groupby([*ARM, "repeat"], sort=False):
        truth, probability = truth_and_probability(part)
        counts = count_tested(part["subject"], truth, range(probability.shape[1])) | {"test_radiographs": len(part)}
        rows.append(dict(zip([*ARM, "repeat"], key, strict=True)) | score(truth, probability) | counts)
    return pd.DataFrame(rows)


def summarise(scores: pd.DataFrame) -> pd.DataFrame:
    """One row an arm: mean and standard deviation of each metric over the splits that gave it, and how many did."""
    rows = []
    for key, part in scores.groupby(ARM, sort=False):
        row = dict(zip(ARM, key, strict=True)) | {"splits": int(part["auc"].notna().sum())}
        for metric in METRICS:
            spread = part[metric].std(ddof=1) if part[metric].notna().sum() > 1 else float("nan")
            row |= {metric: part[metric].mean(), f"{metric}_sd": spread}
        counts = {name: int(part[name].median()) for name in (*TESTED, "test_radiographs")}
        rows.append(row | counts)
    return pd.DataFrame(rows)
