"""Reading and writing of study results: tables, JSON files, HTML pages and figures."""

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
    """Write a data frame without its index as CSV, with all digits that are needed to restore floats exactly.

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
    """Read a CSV file that `save_table` wrote, with identical values.

    Parameters
    ----------
    path : Path
        File to read.
    text_columns : tuple of str
        Names of the text columns. All other columns contain floats, and an empty cell is NaN.

    Returns
    -------
    pandas.DataFrame or None
        Data frame, or None if the file does not exist.

    Raises
    ------
    InputError
        The file is not a table, or a column name is repeated.
    """
    import pandas as pd

    if not path.exists():
        return None

    def numbered(text: str) -> pd.DataFrame:
        require_unique_columns(path, parse_csv_header(text))
        table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
        numbers = table.columns.difference(text_columns)
        # Python parses floats exactly, whereas the last digits from pandas.read_csv depend on the pandas version.
        table[numbers] = table[numbers].replace("", "nan").astype(float)
        return table

    table: pd.DataFrame = parse_text(path, read_text(path), numbered)
    return table


def load_typed_table(path: Path) -> "pd.DataFrame":
    """Read a CSV file that `save_table` wrote, and infer the type of each column: integer, float or text.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    pandas.DataFrame
        Data frame with the same float values as the saved table.

    Raises
    ------
    InputError
        The file cannot be read, or a column name is repeated.
    """
    import pandas as pd

    text = read_text(path)
    require_unique_columns(path, parse_csv_header(text))
    table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
    return table.apply(_convert_column)


def _convert_column(column: "pd.Series") -> "pd.Series":
    """Convert a text column to integers or else to floats, and return any other column unchanged."""
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
    """Read a JSON file as a record, or as another type that msgspec supports.

    Parameters
    ----------
    path : Path
        File to read.
    kind : type
        Type to which the content is converted.

    Returns
    -------
    object of type `kind`, or None
        Content of the file, or None if the file does not exist or the content has another type.
    """
    try:
        held: T = read_json(path, kind)
        return held
    except InputError:
        return None


def save_json(path: Path, value: Any) -> None:
    """Write a value as indented JSON, with unchanged key order.

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
    """Write a text file in UTF-8.

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
    """Write a binary file, such as a figure or a model.

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
