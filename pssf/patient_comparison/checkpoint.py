"""Checkpoints of the patient comparison: results of earlier runs in the same folder, reused if their key matches."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..core.stage_timer import make_interval_check
from ..data.table_records import Record, encode_records
from ..geometry.mesh import Mesh
from ..io import study_results
from ..io.cohort_records import hash_file
from ..radiomics.features.feature_table import SAVE_INTERVAL_S

Row = dict[str, Any]
# Callback that receives number and values of each finished row.
RowCallback = Callable[[int, Row], None]
# Code that sampled knees depend on, besides their grade table.
CODE_PATHS = ("anatomy", "core", "data", "geometry", "model", "patient_comparison")


def compute_key(code: Mapping[str, str], *inputs: bytes) -> str:
    """Compute a key from code hashes and input data.

    Parameters
    ----------
    code : mapping of str to str
        Hashes from :func:`~pssf.data.code_hash.compute_code_hashes`.
    *inputs : bytes
        Input data.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    digest = hashlib.sha256(json.dumps(dict(code)).encode())
    for fact in inputs:
        digest.update(hashlib.sha256(fact).digest())
    return digest.hexdigest()[:16]


def hash_bones(bones: Mapping[str, Iterable[Mesh]]) -> bytes:
    """Hash the vertices and faces of all bones.

    Parameters
    ----------
    bones : mapping of str to iterable of Mesh
        Meshes of each bone.

    Returns
    -------
    bytes
        SHA-256 digest.
    """
    held = hashlib.sha256()
    for name, meshes in bones.items():
        for mesh in meshes:
            held.update(encode_records(name, mesh.vertices.shape, mesh.faces.shape))
            held.update(np.ascontiguousarray(mesh.vertices, np.float64).tobytes())
            held.update(np.ascontiguousarray(mesh.faces, np.int64).tobytes())
    return held.digest()


def save_rows(path: Path, rows: Iterable[Row]) -> None:
    """Save rows as a CSV file.

    Parameters
    ----------
    path : Path
        File to write.
    rows : iterable of dict
        Rows of the table.
    """
    study_results.save_table(path, pd.DataFrame(list(rows)))


def load_known_rows(path: Path, key_column: str, text_columns: tuple[str, ...]) -> dict[str, Row]:
    """Load rows of a CSV file by one of its columns.

    Parameters
    ----------
    path : Path
        CSV file.
    key_column : str
        Column whose values become the keys of the result.
    text_columns : tuple of str
        Columns that hold text.

    Returns
    -------
    dict of str to dict
        Rows by key; empty if the file, the key column or the column ``key`` does not exist.
    """
    table = study_results.load_table(path, text_columns)
    if table is None or not {key_column, "key"} <= set(table):
        return {}
    return {str(row[key_column]): row for row in table.to_dict("records")}


@dataclass(frozen=True, kw_only=True)
class RowCheckpoint:
    """Numeric rows in a CSV file that later runs reuse; rows with other keys are dropped.

    Parameters
    ----------
    path : Path
        CSV file.
    code : mapping of str to str
        Hashes of the code that computes the rows.
    """

    path: Path
    code: Mapping[str, str]

    def complete(self, facts: Sequence[bytes], make: Callable[[list[int], RowCallback], object]) -> list[Row]:
        """Return one row per input; compute only rows that are missing, and save them.

        Parameters
        ----------
        facts : sequence of bytes
            Everything that each row depends on, besides the code.
        make : callable
            Function that computes missing rows. It receives their numbers and a callback for each finished row.

        Returns
        -------
        list of dict
            Rows in the order of `facts`.
        """
        keys = [compute_key(self.code, fact) for fact in facts]
        known = load_known_rows(self.path, "key", ("key",))
        rows = [known.get(key) for key in keys]
        missing = [number for number, row in enumerate(rows) if row is None]
        due = make_interval_check(SAVE_INTERVAL_S)

        def arrived(nth: int, row: Row) -> None:
            rows[missing[nth]] = {"key": keys[missing[nth]], **row}
            if due():
                save_rows(self.path, filter(None, rows))

        if missing:
            try:
                make(missing, arrived)
            finally:
                save_rows(self.path, filter(None, rows))
        return [row for row in rows if row is not None]


class CheckpointManifest(Record, frozen=True):
    """Key and file hashes of a saved section.

    Attributes
    ----------
    key : str
        Key of the inputs of the section.
    sha256 : dict of str to str
        SHA-256 of each file, by file name.
    """

    key: str
    sha256: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class SectionCheckpoint:
    """Tables and figure of a section that are computed together and reused by later runs.

    Parameters
    ----------
    folder : Path
        Output folder of the comparison.
    name : str
        Name of the section and of its figure.
    tables : tuple of str
        Names of its tables.
    key : str
        Key of its inputs.
    """

    folder: Path
    name: str
    tables: tuple[str, ...]
    key: str

    def complete(self, make: Callable[[], tuple[Sequence[Sequence[Row]], bytes]]) -> tuple[list[list[Row]], bytes]:
        """Return tables and figure of the section; compute them if the saved files do not match the key.

        Parameters
        ----------
        make : callable
            Function that computes the rows of each table and the PNG figure.

        Returns
        -------
        list of list of dict
            Rows of each table; empty cells hold an empty string.
        bytes
            PNG figure.
        """
        claim = self.folder / f"{self.name}_kept.json"
        held = study_results.load_json(claim, CheckpointManifest)
        if held is None or held.key != self.key or held.sha256 != self._compute_hashes():
            tables, png = make()
            for path, rows in zip(self._paths[:-1], tables, strict=True):
                save_rows(path, rows)
            study_results.save_bytes(self._paths[-1], png)
            study_results.save_json(claim, {"key": self.key, "sha256": self._compute_hashes()})
        # Files are read back after writing too, so that first and later runs return identical values.
        return [_load_rows(path) for path in self._paths[:-1]], study_results.load_bytes(self._paths[-1])

    @property
    def _paths(self) -> list[Path]:
        """Paths of the tables and, last, of the figure."""
        pictures = self.folder / "pictures"
        return [*(self.folder / f"{name}.csv" for name in self.tables), pictures / f"{self.name}.png"]

    def _compute_hashes(self) -> dict[str, str]:
        """Hash every file of the section that exists."""
        return {path.name: hash_file(path) for path in self._paths if path.exists()}


def _load_rows(path: Path) -> list[Row]:
    """Load the rows of a CSV file with an empty string in each empty cell."""
    rows = study_results.load_typed_table(path).to_dict("records")
    # NaN is the only value that differs from itself.
    return [{str(name): "" if value != value else value for name, value in row.items()} for row in rows]
