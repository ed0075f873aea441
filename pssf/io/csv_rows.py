"""Read CSV files of a user as text; every column name must be unique."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from ..core.checks import InputError
from ..data.user_files import read_text

_ALLOWED = "a CSV table in UTF-8 with one header line"


def read_csv_rows(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Read a CSV file as text.

    Parameters
    ----------
    path : Path
        CSV file in UTF-8, with or without a byte-order mark.

    Returns
    -------
    columns : list of str
        Column names in the order of the header; empty for an empty file.
    rows : list of dict of str to str
        One row per line that is not empty, keyed by column name. A short line has no entries for the missing columns.

    Raises
    ------
    InputError
        The file cannot be read, repeats a column, or has a line with more cells than the header.
    """
    try:
        header, *lines = list(csv.reader(io.StringIO(read_text(path, allowed=_ALLOWED), newline=""))) or [[]]
    except csv.Error as error:
        raise InputError(f"file {path} must be {_ALLOWED}, got a table that cannot be read ({error})") from None
    require_unique_columns(path, header)
    rows = []
    for number, cells in enumerate(lines, start=2):
        if not cells:  # The line is empty.
            continue
        if len(cells) > len(header):
            raise InputError(
                f"file {path}, line {number}: cells must be at most {len(header)}, as in the header, got {len(cells)}"
            )
        rows.append(dict(zip(header, cells, strict=False)))
    return header, rows


def parse_csv_header(text: str) -> list[str]:
    """Read the column names of a CSV text.

    Parameters
    ----------
    text : str
        Content of a CSV file.

    Returns
    -------
    list of str
        Column names in their order; empty for an empty text.
    """
    return next(csv.reader(io.StringIO(text, newline="")), [])


def require_unique_columns(path: Path, columns: Sequence[str]) -> None:
    """Require that every column name of a header is unique.

    A reader would silently lose one of two columns that have the same name.

    Parameters
    ----------
    path : Path
        Path shown in error messages.
    columns : sequence of str
        Column names of the header.

    Raises
    ------
    InputError
        A name is in `columns` more than once.
    """
    for name in columns:
        count = list(columns).count(name)
        if count > 1:
            raise InputError(f"file {path}: column {name!r} must be given once, got it {count} times")
