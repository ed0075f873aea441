"""Checks a cohort's folder against what was written down when it was made."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.userfiles import read_json
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
    if not os.path.exists(folder / "cohort.json"):
        raise InputError(f"folder {folder} has no cohort.json; allowed: a folder that pssf cohort made")
    rows, faults = _manifest(folder)
    claim, asked = _asked(folder, rows)
    faults += asked
    for file, digest in _files(rows).items():
        faults += _image(folder, file, digest)
    faults += _records(folder, rows, claim)
    if rows:
        faults += _extra(folder, rows)
    for name in FOLDERS:
        for path in atomic.unfinished(folder / name):
            faults.append(f"{path.relative_to(folder)}: unfinished (a writer was killed; making the cohort removes it)")
    files = len(_files(rows)) + len({row["knee"] for row in rows}) + 2
    return Verification(radiographs=len(rows), files=files, faults=tuple(faults))


def _manifest(folder: Path) -> tuple[list[Row], list[str]]:
    path = folder / "manifest.csv"
    if not path.exists():
        return [], [f"{path.name}: missing (the cohort is not finished; make it again with what it was made with)"]
    try:
        rows = records.read_csv(path, ("radiograph", "knee", "file", "sha256"))
        named = [records.require_named(row, path) for row in rows]
        return [{"knee": one.knee, "radiograph": one.radiograph, "files": one.files} for one in named], []
    except InputError as error:
        return [], [f"{path.name}: damaged ({error})"]


def _asked(folder: Path, rows: list[Row]) -> tuple[str, list[str]]:
    """Hash of what was asked for, and whether the manifest has its radiographs."""
    path = folder / "cohort.json"
    try:
        asked: records.Asked = read_json(path, records.Asked, allowed="what was asked for")
    except InputError as error:
        return "", [f"cohort.json: damaged ({error})"]
    wanted = [(knee.index, name) for knee in asked.knees for name in knee.radiographs]
    faults = []
    if rows and [(row["knee"], row["radiograph"]) for row in rows] != wanted:
        faults = [f"manifest.csv: {len(rows)} radiographs, not the {len(wanted)} that were asked for"]
    return records.sha256(path), faults


def _files(rows: list[Row]) -> dict[str, str]:
    """File, as it is called from the folder -> hash that the manifest names."""
    return {file: digest for row in rows for file, digest in row["files"].items()}


def _image(folder: Path, file: str, wanted: str) -> Iterator[str]:
    path = folder / file
    if not path.exists():
        yield f"{file}: missing"
        return
    try:
        digest = records.sha256(path)
    except InputError as error:
        yield f"{file}: unreadable ({error})"
        return
    if digest != wanted:
        yield f"{file}: changed (sha256 {digest[:12]}..., in the manifest {wanted[:12]}...)"


def _records(folder: Path, rows: list[Row], claim: str) -> Iterator[str]:
    """Faults of the records, whether they are of what was asked for, and the manifest what they give.

    claim  hash of cohort.json; "" for a damaged one
    """
    given: list[Row] = []
    others: list[str] = []
    whole = True
    for knee in dict.fromkeys(row["knee"] for row in rows):
        path = records.record_path(folder, knee)
        try:
            record = records.knee_record(path)
            given += record.rows
            if claim and record.claim != claim:
                others.append(f"{path.relative_to(folder)}: of another cohort.json (sha256 {record.claim[:12]}...)")
        except InputError as error:
            whole = False
            yield f"{path.relative_to(folder)}: {'damaged' if path.exists() else 'missing'} ({error})"
    if others and len(others) == len({row["knee"] for row in rows}):
        others = ["cohort.json: changed (not what its records were made for)"]
    yield from others
    if rows and whole and not records.same(folder / "manifest.csv", records.as_csv(given)):
        yield "manifest.csv: changed (not what the records of its knees give)"


def _extra(folder: Path, rows: list[Row]) -> Iterator[str]:
    named = {folder / file for file in _files(rows)} | {records.record_path(folder, row["knee"]) for row in rows}
    for name in ("images", "masks", "records"):
        there = set((folder / name).iterdir()) if (folder / name).is_dir() else set()
        for path in sorted(there - named - set(atomic.unfinished(folder / name))):
            yield f"{path.relative_to(folder)}: extra (the manifest does not name it)"
