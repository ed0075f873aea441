"""Files that list the images of a data set, written entry by entry: index and COCO files."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

from ..core.checks import InputError
from ..data.user_files import convert_os_errors
from .atomic_write import replace_file

# Number of rows that are written to a Parquet file together.
_ROWS_PER_GROUP = 10_000


def write_index_table(path: Path, columns: list[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as CSV without holding all of them in memory.

    Parameters
    ----------
    path : Path
        File to write.
    columns : list of str
        All columns.
    rows : iterable of mapping of str to object
        Values keyed by column; a missing value gives an empty cell.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    with replace_file(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as handle:
        writer = csv.DictWriter(handle, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def write_parquet_table(path: Path, columns: Mapping[str, str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as Parquet in groups, without holding all of them in memory.

    Parameters
    ----------
    path : Path
        File to write.
    columns : mapping of str to str
        Kind of values of each column: "boolean", "integer", "decimal" or "text".
    rows : iterable of mapping of str to object
        Values keyed by column; a missing value is null.

    Raises
    ------
    InputError
        The package pyarrow is missing, the disk is full, or the file cannot be written.
    """
    require_parquet()
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    types = {"boolean": pa.bool_(), "integer": pa.int64(), "decimal": pa.float64(), "text": pa.string()}
    schema = pa.schema([(name, types[kind]) for name, kind in columns.items()])
    remaining = iter(rows)
    with replace_file(path) as temporary, ParquetWriter(temporary, schema) as writer:
        while group := list(islice(remaining, _ROWS_PER_GROUP)):
            whole = [{name: _convert_cell(row.get(name), columns[name]) for name in columns} for row in group]
            writer.write_table(pa.Table.from_pylist(whole, schema=schema))


def require_parquet() -> None:
    """Require the package that writes Parquet.

    Raises
    ------
    InputError
        The package is missing.
    """
    if find_spec("pyarrow") is None:
        raise InputError("parquet must be off without the package pyarrow, got parquet = on: install 'pssf[parquet]'")


def read_index_table(path: Path, split: str, names: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """Read columns of the index of a data set.

    Parameters
    ----------
    path : Path
        File index.csv.
    split : str
        Subset whose rows are read.
    names : sequence of str
        Names of the columns to read.

    Returns
    -------
    columns : list of str
        Names of all columns.
    rows : list of list of str
        Text of the requested cells of each row.

    Raises
    ------
    InputError
        The file is missing, which means that the data set is not complete, or cannot be read.
    """
    with convert_os_errors(path, "the index of a complete data set"), open(path, encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        rows = [[row[name] for name in names] for row in reader if row["split"] == split]
        return list(reader.fieldnames or ()), rows


def write_coco_file(
    path: Path,
    *,
    info: Mapping[str, Any],
    categories: list[dict[str, Any]],
    images: Iterable[Mapping[str, Any]],
    annotations: Iterable[Mapping[str, Any]],
) -> None:
    """Write a COCO file without holding all of its entries in memory.

    Parameters
    ----------
    path : Path
        File to write.
    info : mapping of str to object
        Description of the data set.
    categories : list of dict
        Categories with the names of their keypoints.
    images : iterable of mapping of str to object
        Entries of the images.
    annotations : iterable of mapping of str to object
        Entries of the annotations.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    with replace_file(path) as temporary, open(temporary, "w", encoding="utf-8") as handle:
        handle.write(f'{{"info": {json.dumps(info)},\n"categories": {json.dumps(categories)},\n"images": [\n')
        _write_entries(handle, images)
        handle.write('],\n"annotations": [\n')
        _write_entries(handle, annotations)
        handle.write("]}\n")


def _convert_cell(value: Any, kind: str) -> Any:
    """Convert a value to the type of its column."""
    if value is None or kind not in ("decimal", "text"):
        return value
    return float(value) if kind == "decimal" else str(value)


def _write_entries(handle: TextIO, entries: Iterable[Mapping[str, Any]]) -> None:
    """Write the entries of a JSON list, one per line."""
    for number, entry in enumerate(entries):
        handle.write((",\n" if number else "") + json.dumps(entry))
    handle.write("\n")
