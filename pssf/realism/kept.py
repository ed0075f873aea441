"""What an earlier run left in the same folder, and this one goes on from: under a key of all that it hangs on."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..core.timer import seldom
from ..data.records import Record, encoded
from ..geometry.mesh import Mesh
from ..io import results
from ..io.records import sha256
from ..radiomics.table import SAVE_SECONDS

Row = dict[str, Any]
# Tells number and row of each of those that are made, as it ends.
Arrived = Callable[[int, Row], None]
# What drawn knees hang on, beside what they are drawn by.
CODE = ("anatomy", "core", "data", "geometry", "model", "realism")


def key_of(code: Mapping[str, str], *facts: bytes) -> str:
    """A key of code and facts.

    code  of `code_digest`
    """
    digest = hashlib.sha256(json.dumps(dict(code)).encode())
    for fact in facts:
        digest.update(hashlib.sha256(fact).digest())
    return digest.hexdigest()[:16]


def facts_of_bones(bones: Mapping[str, Iterable[Mesh]]) -> bytes:
    """Bytes that are others where any of some bones is."""
    held = hashlib.sha256()
    for name, meshes in bones.items():
        for mesh in meshes:
            held.update(encoded(name, mesh.vertices.shape, mesh.faces.shape))
            held.update(np.ascontiguousarray(mesh.vertices, np.float64).tobytes())
            held.update(np.ascontiguousarray(mesh.faces, np.int64).tobytes())
    return held.digest()


def save_rows(path: Path, rows: Iterable[Row]) -> None:
    """Rows as a CSV."""
    results.save_table(path, pd.DataFrame(list(rows)))


def known_rows(path: Path, by: str, text: tuple[str, ...]) -> dict[str, Row]:
    """Rows of a CSV by one of its columns; none where there is no such file, or no such column.

    text  columns that hold text
    """
    table = results.load_table(path, text)
    if table is None or not {by, "key"} <= set(table):
        return {}
    return {str(row[by]): row for row in table.to_dict("records")}


@dataclass(frozen=True, kw_only=True)
class KeptRows:
    """Rows of numbers that each run in a folder goes on from; those of other keys are dropped.

    path  of the CSV
    code  of `code_digest`: what they are made by
    """

    path: Path
    code: Mapping[str, str]

    def completed(self, facts: Sequence[bytes], make: Callable[[list[int], Arrived], object]) -> list[Row]:
        """One row for each of some facts, in their order.

        facts  all that a row hangs on beside the code
        make   is given the numbers of those that are missing, and whom to tell of each
        """
        keys = [key_of(self.code, fact) for fact in facts]
        known = known_rows(self.path, "key", ("key",))
        rows = [known.get(key) for key in keys]
        missing = [number for number, row in enumerate(rows) if row is None]
        due = seldom(SAVE_SECONDS)

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


class Claim(Record, frozen=True):
    """What files of a folder are of: a key, and their hashes by name."""

    key: str
    sha256: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class KeptPart:
    """Tables and a picture of a part, which are made whole, and stand in a folder where the page's own do.

    name    of the part, and of its picture
    tables  their names
    """

    folder: Path
    name: str
    tables: tuple[str, ...]
    key: str

    def completed(self, make: Callable[[], tuple[Sequence[Sequence[Row]], bytes]]) -> tuple[list[list[Row]], bytes]:
        """Rows of each table, an empty text where a cell holds nothing, and the PNG."""
        claim = self.folder / f"{self.name}_kept.json"
        held = results.load_json(claim, Claim)
        if held is None or held.key != self.key or held.sha256 != self._hashes():
            tables, png = make()
            for path, rows in zip(self._paths[:-1], tables, strict=True):
                save_rows(path, rows)
            results.save_bytes(self._paths[-1], png)
            results.save_json(claim, {"key": self.key, "sha256": self._hashes()})
        # What was made is read too, so that both runs have the same.
        return [_rows_of(path) for path in self._paths[:-1]], results.load_bytes(self._paths[-1])

    @property
    def _paths(self) -> list[Path]:
        pictures = self.folder / "pictures"
        return [*(self.folder / f"{name}.csv" for name in self.tables), pictures / f"{self.name}.png"]

    def _hashes(self) -> dict[str, str]:
        return {path.name: sha256(path) for path in self._paths if path.exists()}


def _rows_of(path: Path) -> list[Row]:
    rows = results.load_typed_table(path).to_dict("records")
    # Only NaN is not itself.
    return [{str(name): "" if value != value else value for name, value in row.items()} for row in rows]
