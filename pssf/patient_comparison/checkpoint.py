"""Save and reuse the results of a patient comparison, so that a repeated run in the same folder resumes."""

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
# Callback that receives the index and the values of each finished row.
RowCallback = Callable[[int, Row], None]
# Subpackages whose code determines the landmarks and bones of sampled knees. Every checkpoint key includes their code
# hashes.
CODE_PATHS = ("anatomy", "core", "data", "geometry", "model", "patient_comparison")


def compute_key(code: Mapping[str, str], *inputs: bytes) -> str:
    """Compute a checkpoint key from code hashes and input data.

    Parameters
    ----------
    code : mapping of str to str
        Hashes from :func:`~pssf.data.code_hash.compute_code_hashes`.
    *inputs : bytes
        Encoded input data that determine the result.

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
        Meshes of every bone, keyed by bone name.

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
    """Load the rows of a CSV file as a dictionary, keyed by the values in one column.

    Parameters
    ----------
    path : Path
        CSV file.
    key_column : str
        Column whose values become the keys of the result.
    text_columns : tuple of str
        Columns with text values.

    Returns
    -------
    dict of str to dict
        Rows keyed by the value in `key_column`; empty if the file, `key_column` or the column ``key`` does not exist.
    """
    table = study_results.load_table(path, text_columns)
    if table is None or not {key_column, "key"} <= set(table):
        return {}
    return {str(row[key_column]): row for row in table.to_dict("records")}


@dataclass(frozen=True, kw_only=True)
class RowCheckpoint:
    """CSV file whose rows later runs reuse, except rows whose code or inputs have changed.

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
        """Return one row per input; compute and save the rows that are missing in the file.

        Parameters
        ----------
        facts : sequence of bytes
            Encoded input of each row.
        make : callable
            Function that computes missing rows. Its arguments are the indices of the missing rows, and a callback
            for each finished row.

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
    """Checkpoint key and file hashes of a saved page section.

    Attributes
    ----------
    key : str
        Checkpoint key computed from code and inputs.
    sha256 : dict of str to str
        SHA-256 hash of each file, keyed by file name.
    """

    key: str
    sha256: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class SectionCheckpoint:
    """Tables and figure of one page section, which later runs reuse if code and inputs have not changed.

    Parameters
    ----------
    folder : Path
        Output folder of the comparison.
    name : str
        Name of the section and of its figure.
    tables : tuple of str
        Names of the tables of the section.
    key : str
        Checkpoint key computed from code and inputs.
    """

    folder: Path
    name: str
    tables: tuple[str, ...]
    key: str

    def complete(self, make: Callable[[], tuple[Sequence[Sequence[Row]], bytes]]) -> tuple[list[list[Row]], bytes]:
        """Return the tables and figure; compute them if the saved files are missing, changed or outdated.

        Parameters
        ----------
        make : callable
            Function that computes the rows of each table and the PNG figure.

        Returns
        -------
        list of list of dict
            Rows of each table; empty cells are empty strings.
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
        # New files are loaded again, so that the first run returns exactly the values that later runs load.
        return [_load_rows(path) for path in self._paths[:-1]], study_results.load_bytes(self._paths[-1])

    @property
    def _paths(self) -> list[Path]:
        """Paths of the tables, followed by the path of the figure."""
        pictures = self.folder / "pictures"
        return [*(self.folder / f"{name}.csv" for name in self.tables), pictures / f"{self.name}.png"]

    def _compute_hashes(self) -> dict[str, str]:
        """Hash every file of the section that exists."""
        return {path.name: hash_file(path) for path in self._paths if path.exists()}


def _load_rows(path: Path) -> list[Row]:
    """Load the rows of a CSV file; empty cells become empty strings."""
    rows = study_results.load_typed_table(path).to_dict("records")
    # NaN is the only value that differs from itself.
    return [{str(name): "" if value != value else value for name, value in row.items()} for row in rows]
