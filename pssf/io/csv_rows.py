"""Rows of CSV files that a user names: columns known and given once, cells as text."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from ..core.checks import InputError
from ..data.userfiles import read_text

_ALLOWED = "a CSV table in UTF-8 with one header line"


def read_rows_of_csv(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Read a CSV file as text.

    Parameters
    ----------
    path : Path
        The file, UTF-8, with or without a byte-order mark.

    Returns
    -------
    columns : list of str
        Names of the header, in their order; none for an empty file.
    rows : list of dict of str to str
        One per line that is not empty; a line that ends early has no entry for the columns after it.

    Raises
    ------
    InputError
        The file cannot be read, has a column twice, or has a line with more cells than the header.
    """
    try:
        header, *lines = list(csv.reader(io.StringIO(read_text(path, allowed=_ALLOWED), newline=""))) or [[]]
    except csv.Error as error:
        raise InputError(f"file {path}: not a table ({error}); allowed: {_ALLOWED}") from None
    require_columns_once(path, header)
    rows = []
    for number, cells in enumerate(lines, start=2):
        if not cells:  # an empty line
            continue
        if len(cells) > len(header):
            raise InputError(
                f"file {path}, line {number}: cells = {len(cells)}; allowed: up to {len(header)}, as the header has"
            )
        rows.append(dict(zip(header, cells, strict=False)))
    return header, rows


def header_of(text: str) -> list[str]:
    """Read the header of a CSV text: the names of its columns, or none."""
    return next(csv.reader(io.StringIO(text, newline="")), [])


def require_columns_once(path: Path, columns: Sequence[str]) -> None:
    """Refuse a header that gives a column twice: of two values of a row one would be lost without a word.

    Raises
    ------
    InputError
        A name stands twice in `columns`.
    """
    for name in columns:
        count = list(columns).count(name)
        if count > 1:
            raise InputError(f"file {path}: column {name!r} is given {count} times; allowed: each column once")
