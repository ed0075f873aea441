"""Scores of predictions per split, and their means per arm."""

import pandas as pd

from ...predictions import ARM_COLUMNS, extract_truth_and_probability
from .metrics import METRICS, score_predictions
from .tested_subjects import TEST_COUNT_COLUMNS, count_test_subjects


def score_splits(predictions: pd.DataFrame) -> pd.DataFrame:
    """Score the predictions of every arm and split.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all splits.

    Returns
    -------
    DataFrame
        One row per arm and split: `ARM_COLUMNS`, repeat, `METRICS`, `TEST_COUNT_COLUMNS`, test_radiographs.
    """
    rows = []
    for key, part in predictions.groupby([*ARM_COLUMNS, "repeat"], sort=False):
        truth, probability = extract_truth_and_probability(part)
        counts = count_test_subjects(part["subject"], truth, range(probability.shape[1])) | {
            "test_radiographs": len(part)
        }
        rows.append(
            dict(zip([*ARM_COLUMNS, "repeat"], key, strict=True)) | score_predictions(truth, probability) | counts
        )
    return pd.DataFrame(rows)


def summarise_scores(scores: pd.DataFrame) -> pd.DataFrame:
    """Average the scores of every arm over the splits.

    Parameters
    ----------
    scores : DataFrame
        Table from `score_splits`.

    Returns
    -------
    DataFrame
        One row per arm: mean and SD of each metric, number of splits with an AUC, and median numbers of test subjects
        and radiographs.
    """
    rows = []
    for key, part in scores.groupby(ARM_COLUMNS, sort=False):
        row = dict(zip(ARM_COLUMNS, key, strict=True)) | {"splits": int(part["auc"].notna().sum())}
        for metric in METRICS:
            spread = part[metric].std(ddof=1) if part[metric].notna().sum() > 1 else float("nan")
            row |= {metric: part[metric].mean(), f"{metric}_sd": spread}
        counts = {name: int(part[name].median()) for name in (*TEST_COUNT_COLUMNS, "test_radiographs")}
        rows.append(row | counts)
    return pd.DataFrame(rows)
