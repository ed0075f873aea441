"""What in a manifest lets a model know grades without knowing knees: refused where it is an error, else its size.

A model cannot tell why a column helps. A film under two subjects stands in training and in test; where grades and
protocols go together, the protocol tells the grade, and harmonising the protocols takes the grade out with it.
"""

import numpy as np
import pandas as pd
from scipy.stats import chi2_contingency, spearmanr
from scipy.stats.contingency import association

from ...core.checks import InputError

# What a radiograph is of must be one: column -> what may not differ within it.
_ONE = {"sha256": ("subject", "knee"), "knee": ("subject", "grade", "side")}
_CALLED = {"sha256": "file with sha256", "knee": "knee"}
# Chance of a finding in a manifest without anything to find.
_ALPHA = 0.001


def require_one_of_each(manifest: pd.DataFrame) -> None:
    """Refuse one file under two subjects or knees, and one knee under two subjects, grades or sides.

    manifest  radiograph, subject, knee, side, grade, sha256
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
                    f"manifest: {_CALLED[column]} {of} has {other} = {given} ({int((counts > 1).sum())} such); "
                    f"allowed: one {other}"
                )


def warnings_of(manifest: pd.DataFrame) -> list[str]:
    """A sentence each on grades that go with the protocol, and with the order of the subjects; with their size.

    manifest  subject, knee, grade, protocol
    """
    return [*_by_protocol(manifest), *_by_order(manifest)]


def _by_protocol(manifest: pd.DataFrame) -> list[str]:
    counts = pd.crosstab(manifest["protocol"], manifest["grade"])
    if min(counts.shape) < 2 or chi2_contingency(counts)[1] > _ALPHA:
        return []
    shares = counts.div(counts.sum(axis=1), axis=0)
    grade = (shares.max() - shares.min()).idxmax()
    of, size = 100 * shares[grade], association(counts.to_numpy())
    return [
        f"Grades are not spread alike over the protocols (Cramér's V {size:.2f}): grade {grade} is {of.min():.0f} % of "
        f"the radiographs under {of.idxmin()} and {of.max():.0f} % under {of.idxmax()}. A model of all protocols may "
        "tell the grade by the protocol, and harmonised features lose what tells the grades."
    ]


def _by_order(manifest: pd.DataFrame) -> list[str]:
    people = manifest.groupby("subject")["grade"].max().sort_index()
    if len(people) < 3 or people.nunique() < 2:
        return []
    rho, p = spearmanr(np.arange(len(people)), people.to_numpy())
    if not p < _ALPHA:
        return []
    return [
        f"Subjects are numbered by their grade (Spearman's rho {rho:+.2f}). No model is given the number, "
        "but who reads or orders by it knows the grade."
    ]
