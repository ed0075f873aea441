"""Reading and writing of cohort records: the specification, one record per knee, and the manifest."""

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
    MOST_BYTES,
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
# Remedy in the error messages for damaged or outdated files of a cohort.
_RECREATE_HINT = "delete the file, and the next run creates it again"


class ManifestEntry(msgspec.Struct, frozen=True, kw_only=True):
    """Manifest columns that identify a radiograph and its files. All other columns of the manifest are ignored.

    Attributes
    ----------
    radiograph : str
        Name of the radiograph.
    knee : int
        Knee number.
    file : str
        Path of the image file, relative to the cohort folder.
    sha256 : str
        SHA-256 hash of the image file, in hexadecimal digits.
    masks : str or None
        Path of the mask file, relative to the cohort folder; None if no masks were saved.
    masks_sha256 : str
        SHA-256 hash of the mask file; empty if no masks were saved.
    """

    radiograph: str
    knee: int
    file: Annotated[str, msgspec.Meta(pattern=r"^images/[^/\\]+$")]
    sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")]
    masks: Annotated[str, msgspec.Meta(pattern=r"^masks/[^/\\]+$")] | None = None
    masks_sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")] = ""

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 hashes of the image and mask files, keyed by file path relative to the cohort folder."""
        return {self.file: self.sha256} | ({self.masks: self.masks_sha256} if self.masks else {})


class KneeRecord(Record, frozen=True):
    """Record of one knee, with the manifest rows of its radiographs.

    Attributes
    ----------
    rows : list of dict
        One row for each radiograph, keyed by column name.
    cohort_sha256 : str
        SHA-256 hash of the file cohort.json that specifies the radiographs.
    sha256 : str
        SHA-256 hash over `rows` and `cohort_sha256`.
    """

    rows: list[dict[str, str | int | float | bool | None]]
    cohort_sha256: str
    sha256: str


class CohortFileProtocol(msgspec.Struct, frozen=True, kw_only=True):
    """Entry for a protocol in the file cohort.json.

    Attributes
    ----------
    name : str
        Name of the protocol.
    """

    name: str


class CohortFileKnee(msgspec.Struct, frozen=True, kw_only=True):
    """Entry for a knee in the file cohort.json.

    Attributes
    ----------
    subject : int
        Subject number.
    index : int
        Knee number.
    radiographs : tuple of str
        Names of the radiographs of the knee, in manifest order.
    """

    subject: int
    index: int
    radiographs: tuple[str, ...]


class CohortFile(Record, frozen=True):
    """Content of the file cohort.json, which specifies a cohort; see `cohort.Plan.build_request`.

    Attributes
    ----------
    preset : str
        Name of the preset.
    seed : int
        Seed of the cohort.
    masks : str
        File format of the masks: "none" or "tif".
    protocols : tuple of CohortFileProtocol
        Protocols of the cohort.
    knees : tuple of CohortFileKnee
        Knees of the cohort.
    engine : str
        Ray caster, "embree" or "scanline".
    versions : dict of str to str
        Library versions, keyed by library name.
    code : dict of str to str
        Code hashes of subpackages and modules, keyed by path.
    """

    preset: str
    seed: int
    masks: str
    protocols: tuple[CohortFileProtocol, ...]
    knees: tuple[CohortFileKnee, ...]
    engine: str
    versions: dict[str, str]
    code: dict[str, str]


def hash_file(path: Path, max_bytes: int = MOST_BYTES) -> str:
    """Compute the SHA-256 hash of a file.

    Parameters
    ----------
    path : Path
        File to read.
    max_bytes : int
        Size limit of the file, in bytes.

    Returns
    -------
    str
        SHA-256 hash in hexadecimal digits.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with convert_os_errors(require_regular_file(path, max_bytes), "a readable file"), open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def claim_folder(path: Path, cohort_content: dict[str, Any]) -> str:
    """Write the specification of a cohort to its folder, or check that an existing specification is identical.

    Parameters
    ----------
    path : Path
        Path of the file cohort.json in the cohort folder.
    cohort_content : dict
        JSON-ready specification. The optional entry `code` contains the hashes of the code that simulates the cohort.

    Returns
    -------
    str
        SHA-256 hash of cohort.json.

    Raises
    ------
    InputError
        The folder contains a different cohort, or a cohort that a different version of the code simulated. The message
        contains the first entry that differs, or all subpackages and modules that differ.
    """
    if not os.path.exists(path):
        write_json(path, cohort_content)
        return hash_file(path)
    claimed: dict[str, Any] = read_json(path, dict[str, Any], allowed="an intact file of pssf (use a new folder)")
    was, wanted = ({name: entry for name, entry in of.items() if name != "code"} for of in (claimed, cohort_content))
    if was != wanted:
        place, old, new = _find_difference(was, wanted)
        what = f"{place} = {old!r}, requested {new!r}"
        raise InputError(f"folder {path.parent} contains a different {path.stem} ({what}); use a new folder")
    parts = format_differing_parts(claimed.get("code", {}), cohort_content.get("code", {}))
    if parts:
        raise InputError(
            f"folder {path.parent} contains a {path.stem} from a different version of the code, with differences in "
            f"{parts}; use the earlier version, or a new folder"
        )
    return hash_file(path)


def require_claimed_folder(path: Path, cohort_sha256: str) -> None:
    """Require that a worker on another machine accesses the correct cohort folder.

    Parameters
    ----------
    path : Path
        Path of the file cohort.json in the cohort folder.
    cohort_sha256 : str
        SHA-256 hash that `claim_folder` returned.

    Raises
    ------
    InputError
        The file is missing on the machine of the worker or belongs to another cohort. The message contains the machine
        name.
    """
    allowed = "all workers must access the same folder under the same path"
    try:
        here = hash_file(path)
    except InputError as error:
        raise InputError(f"on {node()}: {str(error).split(';')[0]}; {allowed}") from None
    if here != cohort_sha256:
        raise InputError(f"on {node()}: folder {path.parent} contains a different cohort; {allowed}")


def write_knee_record(folder: Path, knee: int, rows: list[Row], cohort_sha256: str) -> None:
    """Write the record of one knee with a hash of the record, after all images of the knee have been written.

    Parameters
    ----------
    folder : Path
        Cohort folder.
    knee : int
        Knee number.
    rows : list of dict
        Manifest rows of the radiographs of the knee.
    cohort_sha256 : str
        SHA-256 hash of the file cohort.json that specifies the radiographs.

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
    """Read the record of one knee and verify the image files with the recorded hashes.

    Parameters
    ----------
    folder : Path
        Cohort folder.
    knee : int
        Knee number.
    names : list of str
        Expected names of the radiographs of the knee, in order.
    cohort_sha256 : str
        Expected SHA-256 hash of the file cohort.json to which the record belongs.

    Returns
    -------
    list of dict or None
        Manifest rows; None if the record or one of its image files does not exist yet.

    Raises
    ------
    InputError
        The record or an image file is damaged, or the record belongs to another cohort or knee. The message contains
        the file path.
    """
    path = record_path(folder, knee)
    if not path.exists():
        return None
    record = read_knee_record(path)
    rows = record.rows
    if record.cohort_sha256 != cohort_sha256:
        raise InputError(
            f"file {path} belongs to another cohort (cohort.json with sha256 {record.cohort_sha256[:12]}..., expected "
            f"{cohort_sha256[:12]}...); {_RECREATE_HINT}"
        )
    if [row["radiograph"] for row in rows] != names:
        raise InputError(
            f"file {path} does not list the radiographs of knee {knee}, which are {', '.join(names)}; {_RECREATE_HINT}"
        )
    named = [require_manifest_entry(row, path) for row in rows]
    expected = {folder / file: digest for one in named for file, digest in one.files.items()}
    if not all(file.exists() for file in expected):
        return None
    for file, digest in expected.items():
        now = hash_file(file)
        if now != digest:
            change = f"sha256 {now[:12]}..., recorded {digest[:12]}..."
            raise InputError(f"file {file} is damaged ({change}); {_RECREATE_HINT}")
    return rows


def read_knee_record(path: Path) -> KneeRecord:
    """Read the record of one knee and verify the record with its hash.

    Parameters
    ----------
    path : Path
        Path of the record file.

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
        raise InputError(f"file {path} is damaged (wrong hash); {_RECREATE_HINT}")
    for row in record.rows:
        require_manifest_entry(row, path)
    return record


def require_manifest_entry(row: Row, path: Path) -> ManifestEntry:
    """Extract and validate the columns of a manifest row that identify a radiograph and its files.

    Parameters
    ----------
    row : dict
        Manifest row, keyed by column name.
    path : Path
        Path of the manifest or record, shown in error messages.

    Returns
    -------
    ManifestEntry
        Validated manifest entry.

    Raises
    ------
    InputError
        A column is missing or has the wrong type, or a file is outside the cohort folder.
    """
    try:
        return msgspec.convert(row, ManifestEntry, strict=False)
    except msgspec.ValidationError as error:
        raise InputError(f"file {path} is damaged ({error}); {_RECREATE_HINT}") from None


def write_json(path: Path, content: Any) -> None:
    """Write a value to a JSON file.

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
    """Write table rows to a CSV file with a header.

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
    """Encode table rows as CSV with a header.

    Parameters
    ----------
    rows : list of dict
        Rows, keyed by column name. Columns are written in the order of their first occurrence.

    Returns
    -------
    bytes
        CSV text in UTF-8. A cell is empty if the row has no value for the column.
    """
    text = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, fieldnames=list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def read_csv(path: Path, required: tuple[str, ...]) -> list[Row]:
    """Read the rows of a CSV file and check that required columns are present.

    Parameters
    ----------
    path : Path
        File to read.
    required : tuple of str
        Names of the columns that every row must contain.

    Returns
    -------
    list of dict
        Rows, keyed by column name. All values are strings.

    Raises
    ------
    InputError
        The file cannot be read, a column name is repeated, or a required column is missing.
    """
    rows: list[Row] = list(read_csv_rows(path)[1])
    for name in required:
        if not rows or any(row.get(name) is None for row in rows):
            fault = f"a row without {name}" if rows else "no rows"
            raise InputError(
                f"file {path} must have at least one row, and every row must have the columns {', '.join(required)}, "
                f"got {fault}"
            )
    return rows


def has_content(path: Path, content: bytes) -> bool:
    """Report whether the content of a file equals the expected content.

    Parameters
    ----------
    path : Path
        File to compare.
    content : bytes
        Expected content.

    Returns
    -------
    bool
        True if the file and the expected content have the same SHA-256 hash.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    return hash_file(path) == hashlib.sha256(content).hexdigest()


def _hash_rows(rows: list[Row], cohort_sha256: str) -> str:
    """Compute the SHA-256 hash over the rows of a knee record and the hash of the cohort.json."""
    return hashlib.sha256(json.dumps([cohort_sha256, rows], sort_keys=True).encode()).hexdigest()


def record_path(folder: Path, knee: int) -> Path:
    """Return the path of the record file of one knee.

    Parameters
    ----------
    folder : Path
        Cohort folder.
    knee : int
        Knee number.

    Returns
    -------
    Path
        Path of the record file.
    """
    return folder / "records" / f"k{knee:04d}.json"


def _find_difference(old: Any, new: Any, place: str = "") -> tuple[str, Any, Any]:
    """Return the path of the first difference between two JSON values, with the old and the new entry."""
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
    """Read the manifest of a cohort as a data frame. The function requires pandas (`study` extra).

    Parameters
    ----------
    path : Path
        Path of the file manifest.csv of a cohort.

    Returns
    -------
    pandas.DataFrame
        Manifest with one row per radiograph.

    Raises
    ------
    InputError
        The file cannot be read or is not a table, or a column name is repeated.
    """
    import pandas as pd

    allowed = "manifest.csv of a cohort"
    text = read_text(path)
    require_unique_columns(path, parse_csv_header(text))  # pandas would silently rename a repeated column.
    table: pd.DataFrame = parse_text(path, io.StringIO(text), pd.read_csv, fault="not a manifest", allowed=allowed)
    # pandas stores the columns separately, and warns when a column is added to more than 100 columns. A copy merges
    # the columns and prevents the warning.
    return table.copy()
