"""Read and write the records of a cohort: its specification, one record per knee, and the manifest."""

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
from ..data.code_hash import format_differing_parts
from ..data.table_records import Record
from ..data.user_files import (
    convert_os_errors,
    parse_text,
    read_json,
    read_text,
    require_regular_file,
)
from .atomic_write import write_bytes
from .csv_rows import parse_csv_header, read_csv_rows, require_unique_columns

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]


class ManifestEntry(msgspec.Struct, frozen=True, kw_only=True):
    """Entries of a manifest row that identify a radiograph and its files; all other columns are ignored.

    Attributes
    ----------
    radiograph : str
        Name of the radiograph.
    knee : int
        Number of the knee.
    file : str
        Image file, relative to the folder of the cohort.
    sha256 : str
        SHA-256 of the image file, in hexadecimal digits.
    masks : str or None
        Mask file, relative to the folder of the cohort; None if no masks were saved.
    masks_sha256 : str
        SHA-256 of the mask file; empty if no masks were saved.
    """

    radiograph: str
    knee: int
    file: Annotated[str, msgspec.Meta(pattern=r"^images/[^/\\]+$")]
    sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")]
    masks: Annotated[str, msgspec.Meta(pattern=r"^masks/[^/\\]+$")] | None = None
    masks_sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")] = ""

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of each file, keyed by its path relative to the folder of the cohort."""
        return {self.file: self.sha256} | ({self.masks: self.masks_sha256} if self.masks else {})


class KneeRecord(Record, frozen=True):
    """Record of one knee: the manifest rows of its radiographs.

    Attributes
    ----------
    rows : list of dict
        One row per radiograph, keyed by column name.
    cohort_sha256 : str
        SHA-256 of the cohort.json for which the radiographs were made.
    sha256 : str
        SHA-256 of `rows` and `cohort_sha256`.
    """

    rows: list[dict[str, str | int | float | bool | None]]
    cohort_sha256: str
    sha256: str


class CohortFileProtocol(msgspec.Struct, frozen=True, kw_only=True):
    """Entry of a protocol in cohort.json.

    Attributes
    ----------
    name : str
        Name of the protocol.
    """

    name: str


class CohortFileKnee(msgspec.Struct, frozen=True, kw_only=True):
    """Entry of a knee in cohort.json.

    Attributes
    ----------
    subject : int
        Number of the subject.
    index : int
        Number of the knee.
    radiographs : tuple of str
        Names of the radiographs of the knee, in order.
    """

    subject: int
    index: int
    radiographs: tuple[str, ...]


class CohortFile(Record, frozen=True):
    """Content of cohort.json, the specification of a cohort; see `cohort.Plan.build_request`.

    Attributes
    ----------
    preset : str
        Name of the preset.
    seed : int
        Seed of the cohort.
    masks : str
        Format of the masks, "none" or "tif".
    protocols : tuple of CohortFileProtocol
        Protocols of the cohort.
    knees : tuple of CohortFileKnee
        Knees of the cohort.
    engine : str
        Ray caster, "embree" or "scanline".
    versions : dict of str to str
        Version of each library, keyed by its name.
    code : dict of str to str
        Hash of the code of each subpackage or module, keyed by its path.
    """

    preset: str
    seed: int
    masks: str
    protocols: tuple[CohortFileProtocol, ...]
    knees: tuple[CohortFileKnee, ...]
    engine: str
    versions: dict[str, str]
    code: dict[str, str]


def hash_file(path: Path) -> str:
    """Compute the SHA-256 of a file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with convert_os_errors(require_regular_file(path), "a readable file"), open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def claim_folder(path: Path, cohort_content: dict[str, Any]) -> str:
    """Write the specification of a cohort into its folder, or check that an existing specification is the same.

    Parameters
    ----------
    path : Path
        The cohort.json of the folder.
    cohort_content : dict
        JSON-ready specification. Its optional entry `code` has the hashes of the code that makes the cohort.

    Returns
    -------
    str
        SHA-256 of cohort.json.

    Raises
    ------
    InputError
        The folder has another cohort, or a cohort made by other code. The message names the first entry that differs,
        or every part of the code that differs.
    """
    if not os.path.exists(path):
        write_json(path, cohort_content)
        return hash_file(path)
    claimed: dict[str, Any] = read_json(path, dict[str, Any], allowed="an intact file of pssf (use a new folder)")
    was, wanted = ({name: entry for name, entry in of.items() if name != "code"} for of in (claimed, cohort_content))
    if was != wanted:
        place, old, new = _find_difference(was, wanted)
        what = f"{place} = {old!r}, requested {new!r}"
        raise InputError(f"folder {path.parent} must be new or have the requested cohort, got {what}: use a new folder")
    parts = format_differing_parts(claimed.get("code", {}), cohort_content.get("code", {}))
    if parts:
        what = f"a cohort made by other code ({parts})"
        raise InputError(
            f"folder {path.parent} must have a cohort made by this code, got {what}: use that code, or a new folder"
        )
    return hash_file(path)


def require_claimed_folder(path: Path, cohort_sha256: str) -> None:
    """Require that a worker on another machine accesses the folder of the cohort that it works on.

    Parameters
    ----------
    path : Path
        The cohort.json of the folder.
    cohort_sha256 : str
        SHA-256 that `claim_folder` returned.

    Raises
    ------
    InputError
        The file is missing on the machine of the worker, or belongs to another cohort. The message names the machine.
    """
    allowed = "all workers must share the folder under the same path"
    try:
        here = hash_file(path)
    except InputError as error:
        raise InputError(f"on {node()}: {str(error).split(';')[0]}; {allowed}") from None
    if here != cohort_sha256:
        raise InputError(
            f"on {node()}: folder {path.parent} must have the cohort of this run, got another cohort: {allowed}"
        )


def write_knee_record(folder: Path, knee: int, rows: list[Row], cohort_sha256: str) -> None:
    """Write the record of one knee and a hash of the record, after the images of the knee were written.

    Parameters
    ----------
    folder : Path
        Folder of the cohort.
    knee : int
        Number of the knee.
    rows : list of dict
        Manifest rows of the radiographs of the knee.
    cohort_sha256 : str
        SHA-256 of the cohort.json for which the radiographs were made.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    write_json(
        record_path(folder, knee),
        {"rows": rows, "cohort_sha256": cohort_sha256, "sha256": _hash_rows(rows, cohort_sha256)},
    )


def read_verified_rows(folder: Path, knee: int, names: list[str], cohort_sha256: str) -> list[Row] | None:
    """Read the record of one knee and check its images against their hashes.

    Parameters
    ----------
    folder : Path
        Folder of the cohort.
    knee : int
        Number of the knee.
    names : list of str
        Names that the radiographs of the knee must have, in order.
    cohort_sha256 : str
        SHA-256 of the cohort.json to which the record must belong.

    Returns
    -------
    list of dict or None
        Manifest rows; None if the record or one of its images does not exist yet.

    Raises
    ------
    InputError
        A record or an image is damaged, or the record belongs to another cohort or knee. The message names the file.
    """
    path = record_path(folder, knee)
    if not path.exists():
        return None
    record = read_knee_record(path)
    rows = record.rows
    if record.cohort_sha256 != cohort_sha256:
        raise InputError(
            f"file {path} must belong to a cohort.json with sha256 {cohort_sha256[:12]}..., got "
            f"{record.cohort_sha256[:12]}...: delete it and it is made again"
        )
    if [row["radiograph"] for row in rows] != names:
        raise InputError(
            f"file {path} must have the radiographs of knee {knee}, {', '.join(names)}, got others: "
            "delete it and it is made again"
        )
    named = [require_manifest_entry(row, path) for row in rows]
    expected = {folder / file: digest for one in named for file, digest in one.files.items()}
    if not all(file.exists() for file in expected):
        return None
    for file, digest in expected.items():
        now = hash_file(file)
        if now != digest:
            change = f"sha256 {now[:12]}..., recorded {digest[:12]}..."
            raise InputError(f"file {file} is damaged ({change}); delete it and it is made again")
    return rows


def read_knee_record(path: Path) -> KneeRecord:
    """Read the record of one knee and check it against the hash in the record.

    Parameters
    ----------
    path : Path
        File of the record.

    Returns
    -------
    KneeRecord
        Verified record.

    Raises
    ------
    InputError
        The record is damaged.
    """
    record: KneeRecord = read_json(path, KneeRecord)
    if record.sha256 != _hash_rows(record.rows, record.cohort_sha256):
        raise InputError(f"file {path} is damaged (wrong hash); delete it and it is made again")
    for row in record.rows:
        require_manifest_entry(row, path)
    return record


def require_manifest_entry(row: Row, path: Path) -> ManifestEntry:
    """Read the columns of a manifest row that identify a radiograph and its files.

    Parameters
    ----------
    row : dict
        Manifest row, keyed by column name.
    path : Path
        Path of the manifest or record, shown in error messages.

    Returns
    -------
    ManifestEntry
        Verified entry.

    Raises
    ------
    InputError
        A column is missing or has a wrong type, or a file is outside the folder of the cohort.
    """
    try:
        return msgspec.convert(row, ManifestEntry, strict=False)
    except msgspec.ValidationError as error:
        raise InputError(f"file {path} is damaged ({error}); delete it and it is made again") from None


def write_json(path: Path, content: Any) -> None:
    """Write a value as JSON.

    Parameters
    ----------
    path : Path
        File to write.
    content : object
        JSON-ready value.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV with a header.

    Parameters
    ----------
    path : Path
        File to write.
    rows : list of dict
        Rows, keyed by column name. Columns are written in the order of their first occurrence.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    write_bytes(path, encode_csv(rows))


def encode_csv(rows: list[Row]) -> bytes:
    """Encode rows as CSV with a header.

    Parameters
    ----------
    rows : list of dict
        Rows, keyed by column name. Columns are written in the order of their first occurrence.

    Returns
    -------
    bytes
        CSV in UTF-8. A cell is empty if its row lacks the column.
    """
    text = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, fieldnames=list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def read_csv(path: Path, required: tuple[str, ...]) -> list[Row]:
    """Read the rows of a CSV file that must have certain columns.

    Parameters
    ----------
    path : Path
        File to read.
    required : tuple of str
        Columns that every row must have.

    Returns
    -------
    list of dict
        Rows, keyed by column name; all values are text.

    Raises
    ------
    InputError
        The file cannot be read, repeats a column, or lacks a required column.
    """
    rows: list[Row] = list(read_csv_rows(path)[1])
    for name in required:
        if not rows or any(row.get(name) is None for row in rows):
            raise InputError(
                f"file {path}: every row must have the columns {', '.join(required)}, got none, or a row without {name}"
            )
    return rows


def has_content(path: Path, content: bytes) -> bool:
    """Return whether a file has the given content.

    Parameters
    ----------
    path : Path
        File to compare.
    content : bytes
        Expected content.

    Returns
    -------
    bool
        True if file and expected content have the same SHA-256.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    return hash_file(path) == hashlib.sha256(content).hexdigest()


def _hash_rows(rows: list[Row], cohort_sha256: str) -> str:
    """Compute one SHA-256 over the rows of a record and the hash of its cohort.json."""
    return hashlib.sha256(json.dumps([cohort_sha256, rows], sort_keys=True).encode()).hexdigest()


def record_path(folder: Path, knee: int) -> Path:
    """Return the path of the record of one knee.

    Parameters
    ----------
    folder : Path
        Folder of the cohort.
    knee : int
        Number of the knee.

    Returns
    -------
    Path
        File of the record.
    """
    return folder / "records" / f"k{knee:04d}.json"


def _find_difference(old: Any, new: Any, place: str = "") -> tuple[str, Any, Any]:
    """Return the path of the first entry in which two JSON values differ, and both entries."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in [*new, *(n for n in old if n not in new)]:
            if old.get(name) != new.get(name):
                return _find_difference(old.get(name), new.get(name), f"{place}.{name}" if place else name)
    if isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            return f"number of {place}", len(old), len(new)
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            if a != b:
                return _find_difference(a, b, f"{place}[{k}]")
    return place, old, new


def read_manifest(path: Path) -> "pd.DataFrame":
    """Read the manifest of a cohort as a data frame; this needs pandas (`study` extra).

    Parameters
    ----------
    path : Path
        The manifest.csv of a cohort.

    Returns
    -------
    pandas.DataFrame
        One row per radiograph.

    Raises
    ------
    InputError
        The file cannot be read, is not a table, or repeats a column.
    """
    import pandas as pd

    allowed = "manifest.csv of a cohort"
    text = read_text(path)
    require_unique_columns(path, parse_csv_header(text))  # pandas would rename a repeated column.
    table: pd.DataFrame = parse_text(path, io.StringIO(text), pd.read_csv, fault="not a manifest", allowed=allowed)
    # pandas stores the columns separately, and warns if a column is added to more than a hundred. A copy joins them.
    return table.copy()
