"""A cohort's records: what was asked for, a record a knee, and the manifest."""

import csv
import hashlib
import io
import json
import os
from pathlib import Path
from platform import node
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from ..core.checks import InputError
from ..data.code import differing
from ..data.records import Record
from ..data.userfiles import parsed, read_json, read_text, refusing, require_file
from .atomic import write_bytes
from .csv_rows import header_of, read_rows_of_csv, require_columns_once

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]


class Named(msgspec.Struct, frozen=True, kw_only=True):
    """What of a row of a manifest finds its radiograph; the rest of the row may be anything."""

    radiograph: str
    knee: int
    file: Annotated[str, msgspec.Meta(pattern=r"^images/[^/\\]+$")]
    sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")]
    masks: Annotated[str, msgspec.Meta(pattern=r"^masks/[^/\\]+$")] | None = None
    masks_sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")] = ""

    @property
    def files(self) -> dict[str, str]:
        """File, as it is called from the cohort's folder -> hash."""
        return {self.file: self.sha256} | ({self.masks: self.masks_sha256} if self.masks else {})


class KneeRecord(Record, frozen=True):
    """Rows of a knee's radiographs; claim: hash of the cohort.json that they were made for; sha256 of both."""

    rows: list[dict[str, str | int | float | bool | None]]
    claim: str
    sha256: str


class AskedProtocol(msgspec.Struct, frozen=True, kw_only=True):
    """Of a protocol in cohort.json."""

    name: str


class AskedKnee(msgspec.Struct, frozen=True, kw_only=True):
    """Of a knee in cohort.json; radiographs: their names, in order."""

    subject: int
    index: int
    radiographs: tuple[str, ...]


class Asked(Record, frozen=True):
    """cohort.json: what a folder is for; see `cohort.Plan.table`."""

    preset: str
    seed: int
    masks: str
    protocols: tuple[AskedProtocol, ...]
    knees: tuple[AskedKnee, ...]
    engine: str
    versions: dict[str, str]
    code: dict[str, str]


def sha256(path: Path) -> str:
    """Hex digest of a file.

    raises  InputError for a file that cannot be read
    """
    with refusing(require_file(path), "a readable file"), open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def claim(path: Path, asked: dict[str, Any]) -> str:
    """Write down what a folder is for, and return the hash of that; refuse a folder that is for something else.

    asked   JSON-ready; its entry `code`, if any, is what it is made by, see `code.code_digest`
    raises  InputError naming the first entry that differs, or all parts of the code that do
    """
    if not os.path.exists(path):
        write_json(path, asked)
        return sha256(path)
    claimed: dict[str, Any] = read_json(path, dict[str, Any], allowed="a new folder")
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


def write_rows(folder: Path, knee: int, rows: list[Row], claim: str) -> None:
    """Write the record of one knee, with a hash of its own; its images stand by then.

    claim  hash of the folder's cohort.json, which it was made for
    """
    write_json(record_path(folder, knee), {"rows": rows, "claim": claim, "sha256": _digest(rows, claim)})


def read_rows(folder: Path, knee: int, names: list[str], claim: str) -> list[Row] | None:
    """The record of one knee with its images checked against their hashes, or None where it is still to be made.

    names   of the radiographs that it must be of, in order
    claim   hash of the folder's cohort.json, which it must be made for
    raises  InputError naming a record or an image that is damaged
    """
    path = record_path(folder, knee)
    if not path.exists():
        return None
    record = knee_record(path)
    rows = record.rows
    if record.claim != claim:
        raise InputError(
            f"file {path}: of a cohort.json with sha256 {record.claim[:12]}...; allowed: {claim[:12]}...; delete it to "
            "have it made again"
        )
    if [row["radiograph"] for row in rows] != names:
        raise InputError(
            f"file {path}: not of knee {knee}; allowed: {', '.join(names)}; delete it to have it made again"
        )
    named = [require_named(row, path) for row in rows]
    expected = {folder / file: digest for one in named for file, digest in one.files.items()}
    if not all(file.exists() for file in expected):
        return None
    for file, digest in expected.items():
        now = sha256(file)
        if now != digest:
            change = f"sha256 {now[:12]}..., recorded {digest[:12]}..."
            raise InputError(f"file {file}: damaged ({change}); delete it to have it made again")
    return rows


def knee_record(path: Path) -> KneeRecord:
    """A record, checked against its own hash.

    raises  InputError for a record that is damaged
    """
    record: KneeRecord = read_json(path, KneeRecord)
    if record.sha256 != _digest(record.rows, record.claim):
        raise InputError(f"file {path}: damaged (not as it was written); delete it to have it made again")
    for row in record.rows:
        require_named(row, path)
    return record


def require_named(row: Row, path: Path) -> Named:
    """What of a row finds its radiograph.

    path    of its table, for a refusal
    raises  InputError for a row that lacks it, or leads out of the cohort's folder
    """
    try:
        return msgspec.convert(row, Named, strict=False)
    except msgspec.ValidationError as error:
        raise InputError(f"file {path}: damaged ({error}); delete it to have it made again") from None


def write_json(path: Path, content: Any) -> None:
    """Write a value as JSON."""
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV with a header, columns in the order of the first row."""
    write_bytes(path, as_csv(rows))


def as_csv(rows: list[Row]) -> bytes:
    """What `write_csv` writes; empty where a row lacks what another has."""
    text = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, fieldnames=list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def read_csv(path: Path, required: tuple[str, ...]) -> list[Row]:
    """The rows of a CSV file, all values as text.

    required  columns that every row must have
    raises    InputError for a file that cannot be read, lacks one of them, or has a column twice
    """
    rows: list[Row] = list(read_rows_of_csv(path)[1])
    for name in required:
        if not rows or any(row.get(name) is None for row in rows):
            raise InputError(f"file {path}: no column {name}, or a row without it; required: {', '.join(required)}")
    return rows


def same(path: Path, content: bytes) -> bool:
    """Whether a file holds these bytes."""
    return sha256(path) == hashlib.sha256(content).hexdigest()


def _digest(rows: list[Row], claim: str) -> str:
    return hashlib.sha256(json.dumps([claim, rows], sort_keys=True).encode()).hexdigest()


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

    raises  InputError for a file that cannot be read, or has a column twice
    """
    import pandas as pd

    allowed = "manifest.csv of a cohort"
    text = read_text(path)
    require_columns_once(path, header_of(text))  # pandas would call the second one another name
    table: pd.DataFrame = parsed(path, io.StringIO(text), pd.read_csv, fault="not a manifest", allowed=allowed)
    # pandas reads every column apart, and warns who adds one to more than a hundred; a copy lays them together.
    return table.copy()
