"""Checks of a manifest for leakage: information other than the knee image that predicts the grade.

Contradictory identifiers raise InputError: a radiograph listed under two subjects could be in both the training and the
test set. Associations are reported with their effect size. If grade and protocol are associated, the protocol predicts
the grade, and harmonisation between protocols also removes differences between grades.

A warning is given if p < 0.05. In studies of the usual size, an association that gives an AUC of 0.7 on random labels
has p of about 0.01. A false warning in one of twenty cohorts is preferred to a missed association; the warning states
this rate.
"""

import re
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2_contingency, norm, spearmanr

from ....core.checks import InputError

# Identifier -> columns that must have a single value for each value of the identifier.
_UNIQUE_WITHIN = {"sha256": ("subject", "knee"), "knee": ("subject", "grade", "side")}
# Names of the identifiers in error messages.
_KEY_LABELS = {"sha256": "file with sha256", "knee": "knee"}
# Significance level of each of the two warnings, dimensionless.
_ALPHA = 0.05
_FALSE_ALARM_NOTE = "This warning occurs by chance in one of twenty cohorts without an association"


def require_consistent_identifiers(manifest: pd.DataFrame, table_name: str = "manifest") -> None:
    """Check that a file belongs to one subject and knee, and a knee to one subject, grade and side.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: radiograph, subject, knee, side, grade, sha256.
    table_name : str
        Name of the table in error messages.

    Raises
    ------
    InputError
        A file has two subjects or knees, or a knee has two subjects, grades or sides.
    """
    for column, others in _UNIQUE_WITHIN.items():
        for other in others:
            counts = manifest.groupby(column, sort=False)[other].nunique()
            if (counts > 1).any():
                first = counts.index[counts > 1][0]
                rows = manifest[manifest[column] == first].drop_duplicates(other).head(2)
                given = " and ".join(f"{value}" for value in rows[other])
                of = f"{first[:12]}..." if column == "sha256" else first
                raise InputError(
                    f"{table_name}: {_KEY_LABELS[column]} {of} must have one {other}, got {given} "
                    f"({int((counts > 1).sum())} cases)"
                )


def find_leakage_warnings(manifest: pd.DataFrame) -> list[str]:
    """Find associations between grade and protocol, and between grade and subject order, that need a warning.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: subject, grade, protocol.

    Returns
    -------
    list of str
        One text per warning, with the effect size and the p-value of the association.
    """
    sentence, p = _assess_grade_by_protocol(manifest)
    by_protocol = (
        f"{sentence} A model trained on all protocols may predict the grade from the protocol, and harmonisation also "
        f"removes differences between grades. {_FALSE_ALARM_NOTE}."
    )
    return [*([by_protocol] if p < _ALPHA else []), *_find_order_warnings(manifest)]


def find_leakage_notes(manifest: pd.DataFrame) -> list[str]:
    """Report a difference between the grade distributions of the protocols if it is too small for a warning.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: subject, grade, protocol.

    Returns
    -------
    list of str
        One note; empty if the grade distributions are equal or the difference gives a warning.
    """
    sentence, p = _assess_grade_by_protocol(manifest)
    return [f"{sentence} A difference of this size is compatible with chance."] if _ALPHA <= p < 1 else []


def _assess_grade_by_protocol(manifest: pd.DataFrame) -> tuple[str, float]:
    """Describe the association between grade and protocol; return the text and the p-value.

    p is 1 if there is only one grade or protocol. Each subject is counted once per protocol and grade, because two
    knees of one subject are not independent. Subjects imaged under every protocol make the test more conservative.
    """
    witnesses = manifest[["subject", "protocol", "grade"]].drop_duplicates(ignore_index=True)
    counts = pd.crosstab(witnesses["protocol"], witnesses["grade"])
    if min(counts.shape) < 2:
        return "", 1.0
    p = float(chi2_contingency(counts)[1])
    shares = counts.div(counts.sum(axis=1), axis=0)
    grade = (shares.max() - shares.min()).idxmax()
    of = 100 * shares[grade]
    sentence = (
        f"Grades are distributed unequally over the protocols (Cramér's V {_cramers_v(counts.to_numpy()):.2f}, "
        f"{_format_p(p)}): the fraction of grade {grade} is {of.min():.0f} % under protocol {of.idxmin()} "
        f"and {of.max():.0f} % under protocol {of.idxmax()}."
    )
    return sentence, p


def _cramers_v(counts: NDArray[np.int64]) -> float:
    """Compute Cramér's V of counts (protocols, grades), corrected for chance.

    The correction is that of Bergsma 2013 (J Korean Stat Soc 42, 323).
    """
    whole = counts.sum()
    free = np.array(counts.shape) - 1
    excess = chi2_contingency(counts, correction=False)[0] / whole - free.prod() / (whole - 1)
    levels = free - free**2 / (whole - 1)
    return float(np.sqrt(max(0.0, excess) / levels.min())) if levels.min() > 0 else 0.0


def _find_order_warnings(manifest: pd.DataFrame) -> list[str]:
    """Warn if the order of the subject identifiers predicts the grade."""
    people = manifest.groupby("subject")["grade"].max()
    grades = people.loc[sorted(people.index, key=_natural_sort_key)].to_numpy()
    if len(grades) < 3 or len(set(grades)) < 2:
        return []
    rho, by_rank = spearmanr(np.arange(len(grades)), grades)
    share, chance, by_neighbour = _assess_neighbours(grades)
    p = min(1.0, 2 * min(by_rank, by_neighbour))  # Bonferroni's correction for two tests.
    if not p < _ALPHA:
        return []
    return [
        f"Subjects are numbered by their grade (Spearman's rho {rho:+.2f}; {100 * share:.0f} % have the same grade as "
        f"the preceding subject, {100 * chance:.0f} % expected by chance; {_format_p(p)}). No model of this study uses "
        "subject numbers. Any other method that uses subject numbers, or file names that contain them, can predict the "
        f"grade. Do not use subject numbers or file names as predictors. {_FALSE_ALARM_NOTE}."
    ]


def _natural_sort_key(subject: Any) -> list[Any]:
    """Make a sort key that compares digit sequences as numbers, so that P2 precedes P10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", str(subject))]


def _assess_neighbours(grades: NDArray[Any]) -> tuple[float, float, float]:
    """Test whether consecutive subjects have the same grade more or less often than by chance.

    Return the observed fraction of equal pairs, the fraction expected by chance, and the two-sided p-value. Blocks of
    one grade give more equal pairs, and alternating grades give fewer. The number of equal pairs is the number of
    subjects minus the number of runs (Wald and Wolfowitz; for more than two categories Barton and David 1957,
    Biometrika 44, 168). `grades` is (subjects,), in the order of the subject identifiers.
    """
    n, counts = len(grades), np.unique(grades, return_counts=True)[1].astype(np.float64)
    squares, cubes = (counts**2).sum(), (counts**3).sum()
    expected = (squares - n) / n
    variance = (squares * (squares + n * (n + 1)) - 2 * n * cubes - n**3) / (n**2 * (n - 1))
    pairs = int((grades[1:] == grades[:-1]).sum())
    # The continuity correction is half a pair because the number of pairs is an integer.
    off = max(0.0, abs(pairs - expected) - 0.5)
    p = 2 * float(norm.sf(off / np.sqrt(variance))) if variance > 0 else 1.0
    return pairs / (n - 1), expected / (n - 1), p


def _format_p(p: float) -> str:
    """Format a p-value as text."""
    return "p < 0.001" if p < 0.001 else f"p {p:.3f}"
