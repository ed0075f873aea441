"""Checks a cohort's folder against what was written down when it was made."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..io import atomic, records
from .make import FOLDERS

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Verification:
    """What was checked, and a line for each fault: the file within the folder, and what is wrong with it."""

    radiographs: int
    files: int
    faults: tuple[str, ...]


def verify_cohort(folder: str | Path) -> Verification:
    """Check that a cohort is whole: every radiograph has the hash that the manifest names, nothing is there besides.

    Records have a hash of their own, and the manifest must be, to the byte, what they give.
    raises  InputError for a folder that is no cohort's
    """
    folder = Path(folder)
    if not (folder / "cohort.json").exists():
        raise InputError(f"folder {folder} has no cohort.json; allowed: a folder that pssf cohort made")
    rows, faults = _manifest(folder)
    faults += _asked(folder, rows)
    for row in rows:
        faults += _image(folder, row)
    faults += _records(folder, rows)
    if rows:
        faults += _extra(folder, rows)
    for name in FOLDERS:
        for path in atomic.unfinished(folder / name):
            faults.append(f"{path.relative_to(folder)}: unfinished (a writer was killed; making the cohort removes it)")
    files = len({row["file"] for row in rows}) + len({row["knee"] for row in rows}) + 2
    return Verification(radiographs=len(rows), files=files, faults=tuple(faults))


def _manifest(folder: Path) -> tuple[list[Row], list[str]]:
    path = folder / "manifest.csv"
    if not path.exists():
        return [], [f"{path.name}: missing (the cohort is not finished; make it again with what it was made with)"]
    try:
        rows = records.read_csv(path, ("radiograph", "knee", "file", "sha256"))
        return [{**row, "knee": int(row["knee"])} for row in rows], []
    except ValueError as error:  # of which InputError is one
        return [], [f"{path.name}: damaged ({error})"]


def _asked(folder: Path, rows: list[Row]) -> Iterator[str]:
    """Whether the manifest has as many radiographs as were asked for."""
    try:
        asked = records.read_json(folder / "cohort.json")
        wanted = len(asked["knees"]) * len({protocol["name"] for protocol in asked["protocols"]})
    except (InputError, KeyError, TypeError):
        yield "cohort.json: damaged (not what was asked for)"
        return
    if rows and len(rows) != wanted:
        yield f"manifest.csv: {len(rows)} radiographs, {wanted} were asked for"


def _image(folder: Path, row: Row) -> Iterator[str]:
    path = folder / row["file"]
    if not path.exists():
        yield f"{row['file']}: missing"
        return
    try:
        digest = records.sha256(path)
    except InputError as error:
        yield f"{row['file']}: unreadable ({error})"
        return
    if digest != row["sha256"]:
        yield f"{row['file']}: changed (sha256 {digest[:12]}..., in the manifest {row['sha256'][:12]}...)"


def _records(folder: Path, rows: list[Row]) -> Iterator[str]:
    """Faults of the records, and whether the manifest is what they give."""
    given: list[Row] = []
    whole = True
    for knee in dict.fromkeys(row["knee"] for row in rows):
        path = records.record_path(folder, knee)
        try:
            given += records.rows_of(path)
        except InputError as error:
            whole = False
            yield f"{path.relative_to(folder)}: {'damaged' if path.exists() else 'missing'} ({error})"
    if rows and whole and not records.same(folder / "manifest.csv", records.as_csv(given)):
        yield "manifest.csv: changed (not what the records of its knees give)"


def _extra(folder: Path, rows: list[Row]) -> Iterator[str]:
    named = {folder / row["file"] for row in rows} | {records.record_path(folder, row["knee"]) for row in rows}
    for name in ("images", "records"):
        there = set((folder / name).iterdir()) if (folder / name).is_dir() else set()
        for path in sorted(there - named - set(atomic.unfinished(folder / name))):
            yield f"{path.relative_to(folder)}: extra (the manifest does not name it)"
