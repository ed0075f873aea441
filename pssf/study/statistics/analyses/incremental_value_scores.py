"""Incremental value: AUC of each predictor set with its interval, and paired differences between predictor sets."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ..scores.claims import UNDECIDED
from ..scores.confidence_intervals import apply_holm_within, estimate_mean, estimate_proportion
from ..scores.tested_subjects import TEST_COUNT_COLUMNS, has_enough_test_subjects

# Name of the estimated upper limit of the AUC in the table of predictor sets.
BEST_POSSIBLE = "best possible"
# Question -> two predictor sets; the AUC of the first minus the AUC of the second answers the question.
QUESTIONS = {
    "do features predict better than measured JSW?": ("radiomics", "measured"),
    "do features add to measured JSW?": ("both", "measured"),
    "does texture add to measured JSW?": ("texture", "measured"),
    "does the measurement error of JSW matter?": ("jsw", "measured"),
    "do features predict better than true JSW?": ("radiomics", "jsw"),
    "do all true parameters predict better than features and measured JSW?": ("parameters", "both"),
}
# Significance level of the p-value after Holm's correction, dimensionless.
_SIGNIFICANCE_LEVEL = 0.05


def summarise_predictor_sets(splits: pd.DataFrame) -> pd.DataFrame:
    """Average the AUC of every predictor set over the splits, with its interval.

    Parameters
    ----------
    splits : DataFrame
        Table from `learn.incremental_value.evaluate_predictor_sets`.

    Returns
    -------
    DataFrame
        One row per pair of grades, predictor set and training fraction: grades, predictor_set, training_fraction,
        training_subjects, `TEST_COUNT_COLUMNS`, splits, auc, low, high.
    """
    rows = []
    for (grades, predictor_set, fraction), part in splits.groupby(
        ["grades", "predictor_set", "training_fraction"], sort=False
    ):
        of_splits = estimate_proportion(part["auc"].to_numpy(np.float64), average_test_train_ratio(part))
        counts = {name: int(part[name].median()) for name in ("training_subjects", *TEST_COUNT_COLUMNS)}
        row = {
            "grades": grades,
            "predictor_set": predictor_set,
            "training_fraction": fraction,
            **counts,
            "splits": int(part["auc"].notna().sum()),
        }
        rows.append(row | {"auc": of_splits.value, "low": of_splits.low, "high": of_splits.high})
    return pd.DataFrame(
        rows,
        columns=[
            "grades",
            "predictor_set",
            "training_fraction",
            "training_subjects",
            *TEST_COUNT_COLUMNS,
            "splits",
            "auc",
            "low",
            "high",
        ],
    )


def average_test_train_ratio(part: pd.DataFrame) -> float:
    """Average the ratio of test to training subjects over the splits.

    Parameters
    ----------
    part : DataFrame
        One row per split: test_subjects and training_subjects.

    Returns
    -------
    float
        Mean ratio of test to training subjects, dimensionless.
    """
    return float((part["test_subjects"] / part["training_subjects"]).mean())


def pair_auc_differences(splits: pd.DataFrame, predictor_set: str, reference_set: str) -> pd.DataFrame:
    """Compute the AUC differences between two predictor sets on the same splits.

    Parameters
    ----------
    splits : DataFrame
        Rows of `learn.incremental_value.evaluate_predictor_sets` for one pair of grades and one training fraction.
    predictor_set : str
        Predictor set from whose AUC the AUC of `reference_set` is subtracted.
    reference_set : str
        Predictor set whose AUC is subtracted.

    Returns
    -------
    DataFrame
        One row per split: repeat, training_subjects, `TEST_COUNT_COLUMNS`, auc and difference.
    """
    first, second = (
        splits[splits["predictor_set"] == name].set_index("repeat") for name in (predictor_set, reference_set)
    )
    table = first.loc[first.index.intersection(second.index)]
    return table.assign(difference=table["auc"] - second["auc"]).reset_index()


def compare_predictor_sets(splits: pd.DataFrame) -> pd.DataFrame:
    """Answer each question in `QUESTIONS` for each pair of grades by the paired AUC difference.

    Parameters
    ----------
    splits : DataFrame
        Table from `learn.incremental_value.evaluate_predictor_sets`, trained on all training subjects.

    Returns
    -------
    DataFrame
        Columns: question, grades, predictor_set, reference_set, `TEST_COUNT_COLUMNS`, splits, difference, low, high, p,
        p_holm (p corrected over the pairs of grades of a question), answer ("yes", "no" or "not decidable"). "no" means
        that the first predictor set has a lower AUC.
    """
    rows = []
    for question, (one, other) in QUESTIONS.items():
        for grades, part in splits.groupby("grades", sort=False):
            table = pair_auc_differences(part, one, other)
            if table.empty:
                continue
            of_splits = estimate_mean(table["difference"].to_numpy(np.float64), average_test_train_ratio(table))
            label = {"question": question, "grades": grades, "predictor_set": one, "reference_set": other}
            label |= {name: int(table[name].median()) for name in TEST_COUNT_COLUMNS} | {"splits": len(table)}
            values = {"difference": of_splits.value, "low": of_splits.low, "high": of_splits.high, "p": of_splits.p}
            rows.append({**label, **values})
    columns = [
        "question",
        "grades",
        "predictor_set",
        "reference_set",
        *TEST_COUNT_COLUMNS,
        "splits",
        "difference",
        "low",
        "high",
        "p",
    ]
    table = pd.DataFrame(rows, columns=columns)
    table = table.assign(p_holm=apply_holm_within(table, ["question"]))
    return table.assign(answer=[_decide_answer(row) for row in table.to_dict("records")])


def _decide_answer(row: Mapping[str, float]) -> str:
    """Decide the answer from the corrected p-value and the number of test subjects."""
    if not has_enough_test_subjects(row) or not row["high"] > row["low"] or not row["p_holm"] < _SIGNIFICANCE_LEVEL:
        return UNDECIDED
    return "yes" if row["difference"] > 0 else "no"


def select_best_possible(separability: pd.DataFrame) -> pd.DataFrame:
    """Select the highest AUC of models that use all knee parameters: a lower bound of the best possible AUC.

    Parameters
    ----------
    separability : DataFrame
        Table from `learn.grade_separability.estimate_separability`.

    Returns
    -------
    DataFrame
        One row per pair of grades: grades, predictor_set, knees, auc, low, high.
    """
    part = separability[separability["parameters"] == "all parameters"].sort_values(
        "auc", ascending=False, kind="stable"
    )
    best = part.drop_duplicates("grades").sort_values("grades")
    return best.assign(predictor_set=BEST_POSSIBLE)[
        ["grades", "predictor_set", "knees", "auc", "low", "high"]
    ].reset_index(drop=True)
