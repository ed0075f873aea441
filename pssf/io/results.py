"""Results of a study on disk: tables, JSON, pages and pictures. Each file appears whole or not at all."""

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..core.checks import InputError
from ..data.userfiles import parsed, read_bytes, read_json, read_text
from .atomic import write_bytes
from .csv_rows import header_of, require_columns_once

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
_AGAIN = "delete it to have it made again"


def save_table(path: Path, table: "pd.DataFrame") -> None:
    """CSV without the index; every float with as many digits as give it back."""
    save_text(path, table.to_csv(index=False, lineterminator="\n"))


def load_table(path: Path, text_columns: tuple[str, ...] = ()) -> "pd.DataFrame | None":
    """The CSV, bit for bit as it was saved, or None where there is no such file.

    text_columns  that hold text; all others hold floats, an empty cell is NaN
    raises  InputError for a file that is not a table
    """
    import pandas as pd

    if not path.exists():
        return None

    def numbered(text: str) -> pd.DataFrame:
        require_columns_once(path, header_of(text))
        table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
        numbers = table.columns.difference(text_columns)
        # Python's own reading of a number is exact; that of read_csv depends on the version of pandas.
        table[numbers] = table[numbers].replace("", "nan").astype(float)
        return table

    table: pd.DataFrame = parsed(path, read_text(path), numbered, fault="damaged", allowed=_AGAIN)
    return table


def load_typed_table(path: Path) -> "pd.DataFrame":
    """A CSV of `save_table`; a column is of whole numbers, else of floats, bit for bit, else of text."""
    import pandas as pd

    text = read_text(path)
    require_columns_once(path, header_of(text))
    table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
    return table.apply(_typed)


def _typed(column: "pd.Series") -> "pd.Series":
    for kind, empty in (("int64", ""), ("float64", "nan")):
        try:
            return column.replace("", empty).astype(kind)
        except ValueError:
            pass
    return column


def load_bytes(path: Path) -> bytes:
    """The content of a file.

    raises  InputError for one that cannot be read
    """
    return read_bytes(path)


def load_json(path: Path, kind: type[T]) -> T | None:
    """The content as a record, or another type that msgspec knows; None where there is no such file, or another."""
    try:
        held: T = read_json(path, kind)
        return held
    except InputError:
        return None


def save_json(path: Path, value: Any) -> None:
    """JSON, indented, keys in the order given."""
    save_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def save_text(path: Path, text: str) -> None:
    """UTF-8 text."""
    write_bytes(path, text.encode("utf-8"))


def save_bytes(path: Path, content: bytes) -> None:
    """A picture or a model as it is."""
    write_bytes(path, content)
