"""A cohort's records: what was asked for, a record a knee, and the manifest."""

import csv
import hashlib
import io
import json
from pathlib import Path
from platform import node
from typing import TYPE_CHECKING, Any

from ..core.checks import InputError
from ..data.code import differing
from .atomic import write_bytes

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]


def sha256(path: Path) -> str:
    """Hex digest of a file.

    raises  InputError for a file that cannot be read
    """
    try:
        with open(path, "rb") as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable file") from None


def claim(path: Path, asked: dict[str, Any]) -> str:
    """Write down what a folder is for, and return the hash of that; refuse a folder that is for something else.

    asked   JSON-ready; its entry `code`, if any, is what it is made by, see `code.code_digest`
    raises  InputError naming the first entry that differs, or all parts of the code that do
    """
    if not path.exists():
        write_json(path, asked)
        return sha256(path)
    claimed = read_json(path)
    if not isinstance(claimed, dict):
        raise InputError(f"file {path}: damaged (not what was asked for); allowed: a new folder")
    was, wanted = ({name: entry for name, entry in of.items() if name != "code"} for of in (claimed, asked))
    if was != wanted:
        place, old, new = _difference(was, wanted)
        what = f"{place} = {old!r}, asked for {new!r}"
        raise InputError(f"folder {path.parent} holds another cohort: {what}; allowed: a new folder")
    parts = differing(claimed.get("code", {}), asked.get("code", {}))
    if parts:
        what = f"a cohort made by other code of pssf ({parts})"
        raise InputError(f"folder {path.parent} holds {what}; allowed: the code that made it, or a new folder")
    return sha256(path)


def require_claimed(path: Path, digest: str) -> None:
    """Refuse to work in a folder that is not the one that was claimed, as a worker on another machine may see it.

    raises  InputError naming the machine
    """
    allowed = "allowed: a folder that all workers share, under one path"
    try:
        here = sha256(path)
    except InputError as error:
        raise InputError(f"on {node()}: {str(error).split(';')[0]}; {allowed}") from None
    if here != digest:
        raise InputError(f"on {node()}: folder {path.parent} holds another cohort; {allowed}")


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    raises  InputError for a file that cannot be read or is not JSON
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable file") from None
    except ValueError as error:
        raise InputError(f"file {path}: damaged ({error}); delete it to have it made again") from None


def write_rows(folder: Path, knee: int, rows: list[Row]) -> None:
    """Write the record of one knee, with a hash of its own; its images stand by then."""
    write_json(record_path(folder, knee), {"rows": rows, "sha256": _digest(rows)})


def read_rows(folder: Path, knee: int, names: list[str]) -> list[Row] | None:
    """The record of one knee with its images checked against their hashes, or None where it is still to be made.

    names   of the radiographs that it must be of, in order
    raises  InputError naming a record or an image that is damaged
    """
    path = record_path(folder, knee)
    if not path.exists():
        return None
    rows = rows_of(path)
    if [row["radiograph"] for row in rows] != names:
        raise InputError(
            f"file {path}: not of knee {knee}; allowed: {', '.join(names)}; delete it to have it made again"
        )
    expected = {folder / row["file"]: row["sha256"] for row in rows}
    if not all(file.exists() for file in expected):
        return None
    for file, digest in expected.items():
        now = sha256(file)
        if now != digest:
            change = f"sha256 {now[:12]}..., recorded {digest[:12]}..."
            raise InputError(f"file {file}: damaged ({change}); delete it to have it made again")
    return rows


def rows_of(path: Path) -> list[Row]:
    """The rows of a record, checked against its own hash.

    raises  InputError for a record that is damaged
    """
    record = read_json(path)
    rows = record.get("rows") if isinstance(record, dict) else None
    if not isinstance(rows, list) or record.get("sha256") != _digest(rows):
        raise InputError(f"file {path}: damaged (not as it was written); delete it to have it made again")
    return rows


def write_json(path: Path, content: Any) -> None:
    """Write a value as JSON."""
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV with a header, columns in the order of the first row."""
    write_bytes(path, as_csv(rows))


def as_csv(rows: list[Row]) -> bytes:
    """What `write_csv` writes."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def read_csv(path: Path, required: tuple[str, ...]) -> list[Row]:
    """The rows of a CSV file, all values as text.

    required  columns that every row must have
    raises    InputError for a file that cannot be read or lacks one of them
    """
    try:
        rows: list[Row] = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable file") from None
    except (ValueError, csv.Error) as error:
        raise InputError(f"file {path}: not a table ({error})") from None
    for name in required:
        if not rows or any(row.get(name) is None for row in rows):
            raise InputError(f"file {path}: no column {name}, or a row without it; required: {', '.join(required)}")
    return rows


def same(path: Path, content: bytes) -> bool:
    """Whether a file holds these bytes."""
    return sha256(path) == hashlib.sha256(content).hexdigest()


def _digest(rows: list[Row]) -> str:
    return hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()


def record_path(folder: Path, knee: int) -> Path:
    """Where the record of one knee stands."""
    return folder / "records" / f"k{knee:04d}.json"


def _difference(old: Any, new: Any, place: str = "") -> tuple[str, Any, Any]:
    """Where two JSON values first differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in [*new, *(n for n in old if n not in new)]:
            if old.get(name) != new.get(name):
                return _difference(old.get(name), new.get(name), f"{place}.{name}" if place else name)
    if isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            return f"number of {place}", len(old), len(new)
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            if a != b:
                return _difference(a, b, f"{place}[{k}]")
    return place, old, new


def read_manifest(path: Path) -> "pd.DataFrame":
    """A cohort's manifest as a data frame (needs pandas, of the extra `study`).

    raises  InputError for a file that cannot be read
    """
    import pandas as pd

    try:
        return pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"file {path}: not a manifest ({error}); allowed: manifest.csv of a cohort") from None
