"""Whether the files of a folder say what a list of conditions asks, by what is in them, not by their names."""

import json
import math
import re
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.userfiles import read_json, read_text
from .csv_rows import read_rows_of_csv


def lacking(folder: Path, evidence: str) -> str:
    """The first of some conditions, with ; between them, that a folder does not fulfil; "" where it fulfils all.

        FILE                  is there and not empty; a pattern such as models/*.skops: one of them is
        FILE.html WORDS       the page's text has the words
        FILE.json KEY.KEY     the entry is neither null nor empty
        FILE.json KEY < X     it is a number below X
        FILE.csv COLUMN       holds a value: neither nothing nor one that is no number
        FILE.csv COLUMN = X   holds X
        FILE.csv A+B unique   holds values, no combination of them twice
        FILE.csv COLUMN every holds a value in every row
        FILE.csv COLUMN >= X  holds a number in every row, none less
        FILE.csv COLUMN < X   holds a number in every row, all less than X, a number or another column of the same row

    After "but for COLUMN = X" rows that hold X are not asked. A file that cannot be read fulfils nothing.
    """
    for condition in evidence.split("; "):
        file, _, asked = condition.partition(" ")
        try:
            if not any(_holds(path, asked) for path in sorted(folder.glob(file))):
                return condition
        except (InputError, ValueError):
            return condition
    return ""


def _holds(path: Path, asked: str) -> bool:
    if path.is_dir() or not path.stat().st_size:
        return False
    if not asked:
        return True
    if path.suffix == ".json":
        key, _, most = asked.partition(" < ")
        value = _entry(read_json(path, dict[str, Any]), key.split("."))
        return _is_said(value) and (not most or float(value) < float(most))
    if path.suffix == ".html":
        return asked in " ".join(re.sub(r"<[^>]*>", " ", read_text(path)).split())
    return _table_holds(list(read_rows_of_csv(path)[1]), asked)


def _entry(value: Any, keys: list[str]) -> Any:
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _is_said(value: Any) -> bool:
    """0 and False say something; nothing, an empty text or list, and NaN do not."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return False
    return not (isinstance(value, str | list | dict) and len(value) == 0)


def _table_holds(rows: list[dict[str, Any]], asked: str) -> bool:
    asked, _, spared = asked.partition(" but for ")
    if spared:
        name, _, value = spared.partition(" = ")
        rows = [row for row in rows if row.get(name) != value]
    column, _, wanted = asked.partition(" ")
    relation, _, bound = wanted.partition(" ")
    columns = column.split("+")
    filled = [row for row in rows if _filled(row, columns)]
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


def _filled(row: dict[str, Any], columns: list[str]) -> bool:
    return all((row.get(name) or "").strip().lower() not in ("", "nan") for name in columns)
