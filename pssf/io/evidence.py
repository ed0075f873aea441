"""Whether the files of a folder say what a list of conditions asks, by what is in them, not by their names."""

import csv
import io
import json
import math
import re
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.userfiles import read_json, read_text


def lacking(folder: Path, evidence: str) -> str:
    """The first of some conditions, with ; between them, that a folder does not fulfil; "" where it fulfils all.

        FILE                  is there and not empty; a pattern such as models/*.skops: one of them is
        FILE.html WORDS       the page's text has the words
        FILE.json KEY.KEY     the entry is neither null nor empty
        FILE.csv COLUMN       holds a value: neither nothing nor one that is no number
        FILE.csv COLUMN = X   holds X
        FILE.csv COLUMN >= X  holds numbers, none of them less
        FILE.csv A+B unique   holds values, no combination of them twice

    A file that cannot be read fulfils nothing.
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
        return _is_said(_entry(read_json(path, dict[str, Any]), asked.split(".")))
    text = read_text(path)
    if path.suffix == ".html":
        return asked in " ".join(re.sub(r"<[^>]*>", " ", text).split())
    return _table_holds(list(csv.DictReader(io.StringIO(text))), asked)


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
    column, _, wanted = asked.partition(" ")
    columns = column.split("+")
    values = [json.dumps([row.get(name) for name in columns]) for row in rows if _filled(row, columns)]
    if wanted == "unique":
        return bool(values) and len(set(values)) == len(values) == len(rows)
    plain = [row[column] for row in rows if _filled(row, columns)]
    if wanted.startswith("= "):
        return wanted.removeprefix("= ") in plain
    if wanted.startswith(">= "):
        least = float(wanted.removeprefix(">= "))
        return bool(plain) and all(float(value) >= least for value in plain)
    return bool(plain) and not wanted


def _filled(row: dict[str, Any], columns: list[str]) -> bool:
    return all((row.get(name) or "").strip().lower() not in ("", "nan") for name in columns)
