"""Summarise the index of a data set: kinds of its columns, and numbers of images."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

# Kinds of values in a column. A column with integers and decimal numbers is decimal; otherwise mixed kinds are text.
BOOLEAN, INTEGER, DECIMAL, TEXT = "boolean", "integer", "decimal", "text"


@dataclass
class IndexSummary:
    """Summary of the rows of an index.

    Attributes
    ----------
    columns : dict of str to str
        Kind of values of each column, in the order of the columns.
    counts : Counter
        Number of images, keyed by subset and KL grade.
    subjects : int
        Number of subjects.
    """

    columns: dict[str, str] = field(default_factory=dict)
    counts: Counter[tuple[str, int]] = field(default_factory=Counter)
    subjects: int = 0

    @property
    def landmarks(self) -> list[str]:
        """Names of all landmarks, sorted, so that every file and loader uses the same order."""
        return list_landmarks(self.columns)

    @property
    def images(self) -> int:
        """Number of images."""
        return self.counts.total()


def list_landmarks(columns: Iterable[str]) -> list[str]:
    """List the landmarks of a data set.

    Parameters
    ----------
    columns : iterable of str
        Columns of index.csv.

    Returns
    -------
    list of str
        Names of the landmarks, sorted.
    """
    return sorted(name.removesuffix("_row_px") for name in columns if name.endswith("_row_px"))


def summarise_index(rows: Iterable[Mapping[str, Any]]) -> IndexSummary:
    """Summarise the rows of an index in one pass.

    Parameters
    ----------
    rows : iterable of mapping of str to object
        Values keyed by column. Rows of one subject follow each other.

    Returns
    -------
    IndexSummary
        Summary.
    """
    summary, last = IndexSummary(), None
    for row in rows:
        for name, value in row.items():
            summary.columns[name] = _join_kinds(summary.columns.get(name), _find_mask_class(value))
        summary.counts[row["split"], row["kl"]] += 1
        summary.subjects += row["subject"] != last
        last = row["subject"]
    summary.columns = {name: kind or TEXT for name, kind in summary.columns.items()}
    return summary


def _find_mask_class(value: Any) -> str:
    """Return the kind of a value; empty for None, which fits every kind."""
    kinds = ((type(None), ""), (bool, BOOLEAN), (int, INTEGER), (float, DECIMAL))
    return next((kind for of, kind in kinds if isinstance(value, of)), TEXT)


def _join_kinds(first: str | None, second: str) -> str:
    """Return the kind of a column with values of two kinds."""
    if not first or not second or first == second:
        return first or second
    return DECIMAL if {first, second} == {INTEGER, DECIMAL} else TEXT
