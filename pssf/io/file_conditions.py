"""Conditions on the content of result files, such as required entries and value ranges."""

import json
import math
import re
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.user_files import read_json, read_text
from .csv_rows import read_csv_rows


def find_unmet_condition(folder: Path, conditions: str) -> str:
    """Return the first condition that the files in a folder do not meet.

    Parameters
    ----------
    folder : Path
        Folder that contains the files.
    conditions : str
        Conditions in the format described in Notes, separated by a semicolon and a space.

    Returns
    -------
    str
        First condition that is not met; empty if all conditions are met.

    Notes
    -----
    A condition has one of the following forms::

        FILE                   the file exists and is not empty; a pattern such as models/*.skops requires one match
        FILE.html WORDS        the text of the page contains the words
        FILE.json KEY.KEY      the entry is neither null nor empty
        FILE.json KEY < X      the entry is a number below X
        FILE.csv COLUMN        at least one row has a value that is neither empty nor NaN
        FILE.csv COLUMN = X    at least one row has the value X
        FILE.csv A+B unique    every row has values in columns A and B, and no combination of values is repeated
        FILE.csv COLUMN every  every row has a value
        FILE.csv COLUMN >= X   every row has a number of at least X
        FILE.csv COLUMN < X    every row has a number below X, where X is a number or another column of the same row

    The suffix "but for COLUMN = X" excludes the rows with the value X. An unreadable file meets no condition.
    """
    for condition in conditions.split("; "):
        file, _, asked = condition.partition(" ")
        try:
            if not any(_meets_condition(path, asked) for path in sorted(folder.glob(file))):
                return condition
        except (InputError, ValueError):
            return condition
    return ""


def _meets_condition(path: Path, condition: str) -> bool:
    """Report whether a file meets a condition, which is specified without the file name."""
    if path.is_dir() or not path.stat().st_size:
        return False
    if not condition:
        return True
    if path.suffix == ".json":
        key, _, most = condition.partition(" < ")
        value = _find_entry(read_json(path, dict[str, Any]), key.split("."))
        return _has_value(value) and (not most or float(value) < float(most))
    if path.suffix == ".html":
        return condition in " ".join(re.sub(r"<[^>]*>", " ", read_text(path)).split())
    return _table_meets_condition(list(read_csv_rows(path)[1]), condition)


def _find_entry(value: Any, keys: list[str]) -> Any:
    """Return the entry of nested dictionaries at a sequence of keys, or None if a key is missing."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _has_value(value: Any) -> bool:
    """Report whether a value is neither None nor NaN nor an empty string, list or dict."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return False
    return not (isinstance(value, str | list | dict) and len(value) == 0)


def _table_meets_condition(rows: list[dict[str, Any]], condition: str) -> bool:
    """Report whether the rows of a CSV file meet a condition, which is specified without the file name."""
    condition, _, spared = condition.partition(" but for ")
    if spared:
        name, _, value = spared.partition(" = ")
        rows = [row for row in rows if row.get(name) != value]
    column, _, wanted = condition.partition(" ")
    relation, _, bound = wanted.partition(" ")
    columns = column.split("+")
    filled = [row for row in rows if _is_filled(row, columns)]
    if relation == "=":
        return bound in [row[column] for row in filled]
    if not relation:
        return bool(filled)
    if not filled or len(filled) < len(rows):
        return False
    if relation == "unique":
        return len({json.dumps([row[name] for name in columns]) for row in rows}) == len(rows)
    if relation == ">=":
        return all(float(row[column]) >= float(bound) for row in rows)
    if relation == "<":
        return all(float(row[column]) < float(row.get(bound, bound)) for row in rows)
    return relation == "every"


def _is_filled(row: dict[str, Any], columns: list[str]) -> bool:
    """Report whether all specified columns of a row have a value that is neither empty nor NaN."""
    return all((row.get(name) or "").strip().lower() not in ("", "nan") for name in columns)
