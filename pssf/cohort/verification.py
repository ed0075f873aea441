"""Verify the files of a cohort against the hashes in its manifest and records."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.user_files import read_json
from ..io import atomic_write, cohort_records
from .cohort_maker import SUBFOLDERS

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Report the result of verifying a cohort.

    Attributes
    ----------
    radiographs : int
        Number of radiographs in the manifest.
    files : int
        Number of files that the cohort must have.
    faults : tuple of str
        One line per fault: the file, relative to the folder, and the kind of fault.
    """

    radiographs: int
    files: int
    faults: tuple[str, ...]


def verify_cohort(folder: str | Path) -> Verification:
    """Verify that a cohort is complete and unchanged, and has no extra files.

    Every image must have the hash that the manifest lists. Every knee record must match the hash that it contains. The
    manifest must be byte-identical to the manifest rebuilt from the knee records.

    Parameters
    ----------
    folder : str or Path
        Folder of the cohort.

    Returns
    -------
    Verification
        Numbers of radiographs and files, and one line per fault.

    Raises
    ------
    InputError
        If the folder has no cohort.json.
    """
    folder = Path(folder)
    if not os.path.exists(folder / "cohort.json"):
        raise InputError(f"folder must contain a cohort made by pssf cohort, got {folder}, which has no cohort.json")
    rows, faults = _read_manifest(folder)
    claim, asked = _check_cohort_request(folder, rows)
    faults += asked
    for file, digest in _list_file_hashes(rows).items():
        faults += _check_file(folder, file, digest)
    faults += _check_records(folder, rows, claim)
    if rows:
        faults += _find_extra_files(folder, rows)
    for name in SUBFOLDERS:
        for path in atomic_write.find_temporary_files(folder / name):
            faults.append(
                f"{path.relative_to(folder)}: unfinished (the run was interrupted; run pssf cohort again to remove it)"
            )
    files = len(_list_file_hashes(rows)) + len({row["knee"] for row in rows}) + 2
    return Verification(radiographs=len(rows), files=files, faults=tuple(faults))


def _read_manifest(folder: Path) -> tuple[list[Row], list[str]]:
    """Read the manifest; return its rows and a list of its faults."""
    path = folder / "manifest.csv"
    if not path.exists():
        return [], [f"{path.name}: missing (the cohort is not finished; run pssf cohort again with the same options)"]
    try:
        rows = cohort_records.read_csv(path, ("radiograph", "knee", "file", "sha256"))
        named = [cohort_records.require_manifest_entry(row, path) for row in rows]
        return [{"knee": one.knee, "radiograph": one.radiograph, "files": one.files} for one in named], []
    except InputError as error:
        return [], [f"{path.name}: damaged ({error})"]


def _check_cohort_request(folder: Path, rows: list[Row]) -> tuple[str, list[str]]:
    """Return the hash of cohort.json, and a fault if the manifest and cohort.json list different radiographs."""
    path = folder / "cohort.json"
    try:
        asked: cohort_records.CohortFile = read_json(
            path, cohort_records.CohortFile, allowed="the specification of a cohort"
        )
    except InputError as error:
        return "", [f"cohort.json: damaged ({error})"]
    wanted = [(knee.index, name) for knee in asked.knees for name in knee.radiographs]
    faults = []
    if rows and [(row["knee"], row["radiograph"]) for row in rows] != wanted:
        faults = [f"manifest.csv: has {len(rows)} radiographs, not the {len(wanted)} that cohort.json requests"]
    return cohort_records.hash_file(path), faults


def _list_file_hashes(rows: list[Row]) -> dict[str, str]:
    """List the hashes of all files in the manifest, keyed by path relative to the folder."""
    return {file: digest for row in rows for file, digest in row["files"].items()}


def _check_file(folder: Path, file: str, expected_sha256: str) -> Iterator[str]:
    """Yield a fault if a file is missing, cannot be read, or has another hash."""
    path = folder / file
    if not path.exists():
        yield f"{file}: missing"
        return
    try:
        digest = cohort_records.hash_file(path)
    except InputError as error:
        yield f"{file}: unreadable ({error})"
        return
    if digest != expected_sha256:
        yield f"{file}: changed (sha256 {digest[:12]}..., the manifest has {expected_sha256[:12]}...)"


def _check_records(folder: Path, rows: list[Row], claim: str) -> Iterator[str]:
    """Yield faults of the knee records: damaged, missing, made for another cohort.json, or unlike the manifest.

    `claim` is the hash of cohort.json, or "" if cohort.json is damaged.
    """
    given: list[Row] = []
    others: list[str] = []
    whole = True
    for knee in dict.fromkeys(row["knee"] for row in rows):
        path = cohort_records.record_path(folder, knee)
        try:
            record = cohort_records.read_knee_record(path)
            given += record.rows
            if claim and record.cohort_sha256 != claim:
                others.append(
                    f"{path.relative_to(folder)}: made for another cohort.json (sha256 {record.cohort_sha256[:12]}...)"
                )
        except InputError as error:
            whole = False
            yield f"{path.relative_to(folder)}: {'damaged' if path.exists() else 'missing'} ({error})"
    if others and len(others) == len({row["knee"] for row in rows}):
        others = ["cohort.json: changed (the records were made for another cohort.json)"]
    yield from others
    if rows and whole and not cohort_records.has_content(folder / "manifest.csv", cohort_records.encode_csv(given)):
        yield "manifest.csv: changed (the knee records have other content)"


def _find_extra_files(folder: Path, rows: list[Row]) -> Iterator[str]:
    """Yield a fault for each file that the manifest does not list."""
    named = {folder / file for file in _list_file_hashes(rows)} | {
        cohort_records.record_path(folder, row["knee"]) for row in rows
    }
    for name in ("images", "masks", "records"):
        there = set((folder / name).iterdir()) if (folder / name).is_dir() else set()
        for path in sorted(there - named - set(atomic_write.find_temporary_files(folder / name))):
            yield f"{path.relative_to(folder)}: extra (the manifest does not list it)"
