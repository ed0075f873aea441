"""Reasons why no conclusion can be drawn from a table: too few test subjects, or intervals that are too wide.

The page collapses these tables and shows the reason above them.
"""

import numpy as np
import pandas as pd

from ..statistics.scores.claims import UNDECIDED
from ..statistics.scores.tested_subjects import (
    MIN_TEST_SUBJECTS,
    MIN_TEST_SUBJECTS_PER_CLASS,
    TEST_COUNT_COLUMNS,
    has_enough_test_subjects,
)

_TOO_FEW_SUBJECTS = (
    f"A split has fewer than {MIN_TEST_SUBJECTS} test subjects, or fewer than {MIN_TEST_SUBJECTS_PER_CLASS} of a "
    "grade: no conclusion can be drawn from this table."
)
_NO_INTERVAL = "No value has a 95 % interval: no conclusion can be drawn from this table."


def explain_undecided_claims(claims: pd.DataFrame) -> str:
    """Explain why no claim is decided.

    Parameters
    ----------
    claims : DataFrame
        Table from `claims.evaluate_claims`.

    Returns
    -------
    str
        Sentence; "" if a claim is decided.
    """
    if (claims["verdict"] != UNDECIDED).any():
        return ""
    return 'No claim is decided: all rows are "not decidable".'


def explain_undecided_scores(scores: pd.DataFrame) -> str:
    """Explain why no conclusion can be drawn from the scores of a task.

    Parameters
    ----------
    scores : DataFrame
        Scores of one task with intervals of AUC and numbers of test subjects.

    Returns
    -------
    str
        Sentence; "" if a score has an interval from enough test subjects.
    """
    return _explain_counts(scores) or _explain_intervals(scores, "auc_low", "auc_high")


def explain_undecided_differences(differences: pd.DataFrame) -> str:
    """Explain why no conclusion can be drawn from the differences between arms.

    Parameters
    ----------
    differences : DataFrame
        Differences of one task and metric: low, high and numbers of test subjects.

    Returns
    -------
    str
        Sentence; "" if a difference has an interval from enough test subjects.
    """
    return _explain_counts(differences) or _explain_intervals(differences, "low", "high")


def explain_undecided_intervals(table: pd.DataFrame, low: str, high: str, bound: float | None = None) -> str:
    """Explain why no conclusion can be drawn from a table of intervals.

    Parameters
    ----------
    table : DataFrame
        Table with the columns `low` and `high`.
    low : str
        Name of the column of lower limits.
    high : str
        Name of the column of upper limits.
    bound : float, optional
        Value that an interval must exclude for a conclusion; None: every interval allows a conclusion.

    Returns
    -------
    str
        Sentence; "" if the table is empty or an interval allows a conclusion.
    """
    if table.empty:
        return ""
    if missing := _explain_intervals(table, low, high):
        return missing
    if bound is None or ((table[low] > bound) | (table[high] < bound)).any():
        return ""
    return f"No 95 % interval excludes {bound:g}: no conclusion can be drawn from this table."


def explain_undecided_calibration(calibration: pd.DataFrame) -> str:
    """Explain why no calibration slope could be fitted.

    Parameters
    ----------
    calibration : DataFrame
        Table from `calibration.compute_calibration`.

    Returns
    -------
    str
        Sentence; "" if a slope was fitted or the table is empty.
    """
    if calibration.empty or calibration["slope"].notna().any():
        return ""
    return "No calibration slope can be fitted, because a probability threshold separates the grades perfectly."


def explain_undecided_reliability(stable_counts: pd.DataFrame) -> str:
    """Explain why no conclusion can be drawn about the reliability of features.

    Parameters
    ----------
    stable_counts : DataFrame
        Table from `reliability.count_stable_features`.

    Returns
    -------
    str
        Sentence; "" if enough knees are compared for at least one set of conditions.
    """
    if stable_counts.empty or stable_counts["knees"].max() >= MIN_TEST_SUBJECTS:
        return ""
    return f"Fewer than {MIN_TEST_SUBJECTS} knees are compared: no conclusion can be drawn from this table."


def _explain_counts(table: pd.DataFrame) -> str:
    """Return a note that no row of a table has enough test subjects, or "" if at least one row has enough."""
    enough = any(has_enough_test_subjects(row) for row in table[TEST_COUNT_COLUMNS].to_dict("records"))
    return "" if enough else _TOO_FEW_SUBJECTS


def _explain_intervals(table: pd.DataFrame, low: str, high: str) -> str:
    """Return a note that all intervals in a table have zero width, or "" if at least one interval is wider."""
    ends = table[[low, high]].to_numpy(np.float64)
    known = np.isfinite(ends).all(axis=1)
    return "" if (ends[known, 1] > ends[known, 0]).any() else _NO_INTERVAL
