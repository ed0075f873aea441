"""Read and write the results of a study: tables, JSON, pages and figures."""

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..core.checks import InputError
from ..data.user_files import (
    parse_text,
    read_bytes,
    read_json,
    read_text,
)
from .atomic_write import write_bytes
from .csv_rows import parse_csv_header, require_unique_columns

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")


def save_table(path: Path, table: "pd.DataFrame") -> None:
    """Write a data frame as CSV without its index; floats have enough digits to be read back exactly.

    Parameters
    ----------
    path : Path
        File to write.
    table : pandas.DataFrame
        Table to write.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    save_text(path, table.to_csv(index=False, lineterminator="\n"))


def load_table(path: Path, text_columns: tuple[str, ...] = ()) -> "pd.DataFrame | None":
    """Read a CSV that `save_table` wrote, with the same values.

    Parameters
    ----------
    path : Path
        File to read.
    text_columns : tuple of str
        Columns of text. All other columns have floats, and an empty cell is NaN.

    Returns
    -------
    pandas.DataFrame or None
        The table; None if the file does not exist.

    Raises
    ------
    InputError
        The file is not a table, or repeats a column.
    """
    import pandas as pd

    if not path.exists():
        return None

    def numbered(text: str) -> pd.DataFrame:
        require_unique_columns(path, parse_csv_header(text))
        table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
        numbers = table.columns.difference(text_columns)
        # Python parses floats exactly. The last digits of floats from pandas.read_csv depend on the version of pandas.
        table[numbers] = table[numbers].replace("", "nan").astype(float)
        return table

    table: pd.DataFrame = parse_text(path, read_text(path), numbered)
    return table


def load_typed_table(path: Path) -> "pd.DataFrame":
    """Read a CSV that `save_table` wrote, and infer the type of each column: integers, else floats, else text.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    pandas.DataFrame
        The table, with the same floats as were saved.

    Raises
    ------
    InputError
        The file cannot be read, or repeats a column.
    """
    import pandas as pd

    text = read_text(path)
    require_unique_columns(path, parse_csv_header(text))
    table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
    return table.apply(_convert_column)


def _convert_column(column: "pd.Series") -> "pd.Series":
    """Convert a column of text to integers, else to floats; return it unchanged if neither is possible."""
    for kind, empty in (("int64", ""), ("float64", "nan")):
        try:
            return column.replace("", empty).astype(kind)
        except ValueError:
            pass
    return column


def load_bytes(path: Path) -> bytes:
    """Read the content of a file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    bytes
        Content of the file.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    return read_bytes(path)


def load_json(path: Path, kind: type[T]) -> T | None:
    """Read JSON as a record, or as another type that msgspec supports.

    Parameters
    ----------
    path : Path
        File to read.
    kind : type
        Type of the content.

    Returns
    -------
    object of type `kind`, or None
        The content; None if the file does not exist or has content of another type.
    """
    try:
        held: T = read_json(path, kind)
        return held
    except InputError:
        return None


def save_json(path: Path, value: Any) -> None:
    """Write a value as indented JSON, with keys in the order of the value.

    Parameters
    ----------
    path : Path
        File to write.
    value : object
        JSON-ready value without NaN.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    save_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def save_text(path: Path, text: str) -> None:
    """Write a text in UTF-8.

    Parameters
    ----------
    path : Path
        File to write.
    text : str
        Content of the file.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    write_bytes(path, text.encode("utf-8"))


def save_bytes(path: Path, content: bytes) -> None:
    """Write the bytes of a figure or of a model file.

    Parameters
    ----------
    path : Path
        File to write.
    content : bytes
        Content of the file.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    write_bytes(path, content)
