"""Reuse of the results of an earlier finished run with the same inputs."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import pandas as pd
from msgspec import structs

from ..data.code_hash import compute_code_hashes, list_installed_packages
from ..data.table_records import Record
from ..io import cohort_records, study_results
from .design.patient_sets import FilmSet
from .design.study_settings import StudySettings
from .study_result import StudyResult

_RECORD_FILE = "finished.json"
_FILE_KINDS = ("pictures", "tables", "models")
_LOADED_TABLES = ("scores", "differences", "reliability", "localisation")
_SINGLE_FILES = ("report.html", "study.json", "environment.json", "checklist.json")


class FinishedRun(Record, frozen=True):
    """Files of a finished run and their hashes.

    Attributes
    ----------
    key : str
        Hash of all inputs that affect the results; see `compute_run_key`.
    pictures : dict of str to str
        File of each figure, relative to the folder of the study.
    tables : dict of str to str
        File of each table, relative to the folder of the study.
    models : dict of str to str
        File of each model, relative to the folder of the study.
    seconds : dict of str to float
        Wall time of each stage, in s.
    sha256 : dict of str to str
        SHA-256 of each file, keyed by relative path.
    """

    key: str
    pictures: dict[str, str]
    tables: dict[str, str]
    models: dict[str, str]
    seconds: dict[str, float]
    sha256: dict[str, str]

    def is_complete(self) -> bool:
        """Report whether every file has a hash and all tables in `_LOADED_TABLES` are listed.

        Returns
        -------
        bool
            True if no hash and no table is missing.
        """
        named = {*_SINGLE_FILES, *(file for kind in _FILE_KINDS for file in getattr(self, kind).values())}
        return named == set(self.sha256) and set(_LOADED_TABLES) <= set(self.tables)


def compute_run_key(
    manifests: list[pd.DataFrame], settings: StudySettings, engine: str, films: FilmSet | None = None
) -> str:
    """Compute a hash of all inputs that affect the results of a study, including code and library versions.

    Parameters
    ----------
    manifests : list of DataFrame
        Manifests of cohort radiographs, repeat radiographs and designed radiographs.
    settings : StudySettings
        Settings of the study.
    engine : str
        Name of the ray casting engine.
    films : FilmSet, optional
        Patient radiographs used as an external test set.

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.
    """
    made_by = {"code": compute_code_hashes(), "installed": list_installed_packages()}
    facts = {"settings": asdict(settings), "engine": engine, **made_by, "films": films and films.to_json_dict()}
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for manifest in manifests:
        digest.update(manifest.to_csv(index=False).encode())
    return digest.hexdigest()


def save_finished_run(result: StudyResult, out: Path, key: str) -> None:
    """Write a list of all files of a finished run, with their hashes.

    Parameters
    ----------
    result : StudyResult
        Result of the finished run.
    out : Path
        Folder of the study.
    key : str
        Key from `compute_run_key`.
    """
    files = {
        kind: {name: str(path.relative_to(out)) for name, path in getattr(result, kind).items()} for kind in _FILE_KINDS
    }
    paths = [
        *(out / name for name in _SINGLE_FILES),
        *(out / name for kind in files.values() for name in kind.values()),
    ]
    digests = {str(path.relative_to(out)): cohort_records.hash_file(path) for path in paths}
    end = FinishedRun(key=key, **files, seconds=result.seconds, sha256=digests)
    study_results.save_json(out / _RECORD_FILE, structs.asdict(end))


def load_finished_run(out: Path, key: str) -> StudyResult | None:
    """Load the result of an earlier run with the same run key.

    Parameters
    ----------
    out : Path
        Folder of the study.
    key : str
        Key from `compute_run_key`.

    Returns
    -------
    StudyResult or None
        Result of the earlier run; None if there is no run with the key, or if a file of the run is missing or changed.
    """
    end = study_results.load_json(out / _RECORD_FILE, FinishedRun)
    if end is None or end.key != key or not end.is_complete():
        return None
    for name, digest in end.sha256.items():
        if not (out / name).exists() or cohort_records.hash_file(out / name) != digest:
            return None
    paths = {kind: {name: out / file for name, file in getattr(end, kind).items()} for kind in _FILE_KINDS}
    tables = {name: study_results.load_typed_table(paths["tables"][name]) for name in _LOADED_TABLES}
    return StudyResult(report=out / "report.html", seconds=end.seconds, origin="an earlier run", **paths, **tables)
