"""Reading of CSV files from users, with values as strings and unique column names."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from ..core.checks import InputError
from ..data.user_files import read_text

_ALLOWED = "a CSV table in UTF-8 with a header line"


def read_csv_rows(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Read a CSV file with all values as strings.

    Parameters
    ----------
    path : Path
        CSV file in UTF-8, with or without a byte-order mark.

    Returns
    -------
    columns : list of str
        Column names in the order of the header; empty for an empty file.
    rows : list of dict of str to str
        One row for each line that is not empty, keyed by column name. A row contains no entries for missing cells.

    Raises
    ------
    InputError
        The file cannot be read, a column name is repeated, or a line has more cells than the header.
    """
    try:
        header, *lines = list(csv.reader(io.StringIO(read_text(path, allowed=_ALLOWED), newline=""))) or [[]]
    except csv.Error as error:
        raise InputError(f"file {path} must be {_ALLOWED}, got an unreadable table ({error})") from None
    require_unique_columns(path, header)
    rows = []
    for number, cells in enumerate(lines, start=2):
        if not cells:  # Empty lines are skipped.
            continue
        if len(cells) > len(header):
            raise InputError(
                f"file {path}, line {number}: number of cells must be at most {len(header)}, as in the header, "
                f"got {len(cells)}"
            )
        rows.append(dict(zip(header, cells, strict=False)))
    return header, rows


def parse_csv_header(text: str) -> list[str]:
    """Extract the column names from the content of a CSV file.

    Parameters
    ----------
    text : str
        Content of a CSV file.

    Returns
    -------
    list of str
        Column names in the order of the header; empty for an empty file.
    """
    return next(csv.reader(io.StringIO(text, newline="")), [])


def require_unique_columns(path: Path, columns: Sequence[str]) -> None:
    """Require that all column names of a CSV file are unique.

    If two columns had the same name, one column would be lost without a warning.

    Parameters
    ----------
    path : Path
        Path shown in error messages.
    columns : sequence of str
        Column names of the header.

    Raises
    ------
    InputError
        A column name occurs more than once.
    """
    for name in columns:
        count = list(columns).count(name)
        if count > 1:
            raise InputError(f"file {path}: column name {name!r} must be unique, got {count} columns with this name")
