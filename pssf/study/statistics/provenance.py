"""What in a manifest lets a model know grades without knowing knees: refused where it is an error, else its size.

A model cannot tell why a column helps. A film under two subjects stands in training and in test; where grades and
protocols go together, the protocol tells the grade, and harmonising the protocols takes the grade out with it.
A tie is warned of from p < 0.05 on: at the sizes of studies one by which random labels are told at an AUC of 0.7 has
a p of some 0.01, and a needless warning in one honest cohort of twenty, which says so, costs less than one missed.
"""

import re
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2_contingency, norm, spearmanr

from ...core.checks import InputError

# What a radiograph is of must be one: column -> what may not differ within it.
_ONE = {"sha256": ("subject", "knee"), "knee": ("subject", "grade", "side")}
_CALLED = {"sha256": "file with sha256", "knee": "knee"}
# Chance of a warning of either kind in a manifest without anything to find.
_ALPHA = 0.05
_NEEDLESS = "Of cohorts without such a tie one in twenty is warned of by chance"


def require_one_of_each(manifest: pd.DataFrame, called: str = "manifest") -> None:
    """Refuse one file under two subjects or knees, and one knee under two subjects, grades or sides.

    manifest  radiograph, subject, knee, side, grade, sha256
    called    what an error says that it is
    raises    InputError
    """
    for column, others in _ONE.items():
        for other in others:
            counts = manifest.groupby(column, sort=False)[other].nunique()
            if (counts > 1).any():
                first = counts.index[counts > 1][0]
                rows = manifest[manifest[column] == first].drop_duplicates(other).head(2)
                given = " and ".join(f"{value}" for value in rows[other])
                of = f"{first[:12]}..." if column == "sha256" else first
                raise InputError(
                    f"{called}: {_CALLED[column]} {of} has {other} = {given} ({int((counts > 1).sum())} such); "
                    f"allowed: one {other}"
                )


def warnings_of(manifest: pd.DataFrame) -> list[str]:
    """A sentence each on grades that go with the protocol, and with the order of the subjects; with size and p.

    manifest  subject, grade, protocol
    """
    sentence, p = _spread(manifest)
    by_protocol = (
        f"{sentence} A model of all protocols may tell the grade by the protocol, and harmonised features lose what "
        f"tells the grades. {_NEEDLESS}."
    )
    return [*([by_protocol] if p < _ALPHA else []), *_by_order(manifest)]


def notes_of(manifest: pd.DataFrame) -> list[str]:
    """How unlike the protocols are in their grades, where that is not enough to warn of; nothing where they are alike.

    manifest  of `warnings_of`
    """
    sentence, p = _spread(manifest)
    return [f"{sentence} As much comes about by chance."] if _ALPHA <= p < 1 else []


def _spread(manifest: pd.DataFrame) -> tuple[str, float]:
    """How grades are spread over the protocols in words, and the p of that by chance: 1 where they are alike.

    A person counts once under each protocol with each grade: two knees of one person, which share most of both, are
    not two witnesses. One who is under every protocol makes the test stricter, since protocols are then alike in that.
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
        f"Grades are not spread alike over the protocols (Cramér's V {_cramer(counts.to_numpy()):.2f}, "
        f"{_p(p)}): grade {grade} is {of.min():.0f} % of those under {of.idxmin()} and {of.max():.0f} % of those under "
        f"{of.idxmax()}."
    )
    return sentence, p


def _cramer(counts: NDArray[np.int64]) -> float:
    """Cramér's V less what chance gives it (Bergsma 2013, J Korean Stat Soc 42, 323).

    counts  (protocols, grades)
    """
    whole = counts.sum()
    free = np.array(counts.shape) - 1
    excess = chi2_contingency(counts, correction=False)[0] / whole - free.prod() / (whole - 1)
    levels = free - free**2 / (whole - 1)
    return float(np.sqrt(max(0.0, excess) / levels.min())) if levels.min() > 0 else 0.0


def _by_order(manifest: pd.DataFrame) -> list[str]:
    people = manifest.groupby("subject")["grade"].max()
    grades = people.loc[sorted(people.index, key=_as_numbered)].to_numpy()
    if len(grades) < 3 or len(set(grades)) < 2:
        return []
    rho, by_rank = spearmanr(np.arange(len(grades)), grades)
    share, chance, by_neighbour = _neighbours(grades)
    p = min(1.0, 2 * min(by_rank, by_neighbour))  # of two tests (Bonferroni)
    if not p < _ALPHA:
        return []
    return [
        f"Subjects are numbered by their grade (Spearman's rho {rho:+.2f}; {100 * share:.0f} % have the grade of the "
        f"one before, {100 * chance:.0f} % by chance; {_p(p)}). No model is given the number, but who reads or orders "
        "by it, or by names of files that have it, knows the grade: leave them out of what is learnt from. "
        f"{_NEEDLESS}."
    ]


def _as_numbered(subject: Any) -> list[Any]:
    """A key by which P2 comes before P10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", str(subject))]


def _neighbours(grades: NDArray[Any]) -> tuple[float, float, float]:
    """Share of neighbours in a row that are of one grade, what chance gives, and the two-sided p of the difference.

    Blocks of a grade have more of them, and grades in turn fewer, whatever the order of the grades. Their number is
    that of people less that of runs (Wald and Wolfowitz; of several kinds Barton and David 1957, Biometrika 44, 168).

    grades  (people,) in the order of their numbers
    """
    n, counts = len(grades), np.unique(grades, return_counts=True)[1].astype(np.float64)
    squares, cubes = (counts**2).sum(), (counts**3).sum()
    expected = (squares - n) / n
    variance = (squares * (squares + n * (n + 1)) - 2 * n * cubes - n**3) / (n**2 * (n - 1))
    pairs = int((grades[1:] == grades[:-1]).sum())
    # Half a pair nearer, since pairs are whole.
    off = max(0.0, abs(pairs - expected) - 0.5)
    p = 2 * float(norm.sf(off / np.sqrt(variance))) if variance > 0 else 1.0
    return pairs / (n - 1), expected / (n - 1), p


def _p(p: float) -> str:
    return "p < 0.001" if p < 0.001 else f"p {p:.3f}"
