"""What an earlier run ended with, so that asking for the same again costs seconds."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import pandas as pd
from msgspec import structs

from ..data.code import code_digest, installed
from ..data.records import Record
from ..io import records, results
from .films import FilmSet
from .result import StudyResult
from .settings import StudySettings

_FILE = "finished.json"
_KINDS = ("pictures", "tables", "models")
_LOADED = ("scores", "differences", "reliability", "localisation")
_LOOSE = ("report.html", "study.json", "environment.json", "checklist.json")


class End(Record, frozen=True):
    """What a run ended with: name -> file of each kind, as it is called from the study's folder, and file -> hash."""

    key: str
    pictures: dict[str, str]
    tables: dict[str, str]
    models: dict[str, str]
    seconds: dict[str, float]
    sha256: dict[str, str]

    def whole(self) -> bool:
        """Whether every file has a hash, and those are listed that are read."""
        named = {*_LOOSE, *(file for kind in _KINDS for file in getattr(self, kind).values())}
        return named == set(self.sha256) and set(_LOADED) <= set(self.tables)


def key_of(manifests: list[pd.DataFrame], settings: StudySettings, engine: str, films: FilmSet | None = None) -> str:
    """Hash of all that the results of a study depend on, the code of the package and its libraries included."""
    made_by = {"code": code_digest(), "installed": installed()}
    facts = {"settings": asdict(settings), "engine": engine, **made_by, "films": films and films.facts()}
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for manifest in manifests:
        digest.update(manifest.to_csv(index=False).encode())
    return digest.hexdigest()


def mark(result: StudyResult, out: Path, key: str) -> None:
    """Write down which files a run ended with, and their hashes."""
    files = {
        kind: {name: str(path.relative_to(out)) for name, path in getattr(result, kind).items()} for kind in _KINDS
    }
    paths = [*(out / name for name in _LOOSE), *(out / name for kind in files.values() for name in kind.values())]
    digests = {str(path.relative_to(out)): records.sha256(path) for path in paths}
    end = End(key=key, **files, seconds=result.seconds, sha256=digests)
    results.save_json(out / _FILE, structs.asdict(end))


def earlier(out: Path, key: str) -> StudyResult | None:
    """The result of an earlier run with the same key, or None where a file of it is missing or changed."""
    end = results.load_json(out / _FILE, End)
    if end is None or end.key != key or not end.whole():
        return None
    for name, digest in end.sha256.items():
        if not (out / name).exists() or records.sha256(out / name) != digest:
            return None
    paths = {kind: {name: out / file for name, file in getattr(end, kind).items()} for kind in _KINDS}
    tables = {name: results.load_typed_table(paths["tables"][name]) for name in _LOADED}
    return StudyResult(report=out / "report.html", seconds=end.seconds, origin="an earlier run", **paths, **tables)
