"""What takes seconds to make and depends on the package alone: arrays that come with it, or in the user's cache folder.

A kept file has a digest of what it was made by in its name, so that one made by other code, other tables or other
versions of a library is not found, and made anew. PSSF_CACHE_DIR names another folder; "off" keeps nothing.
What comes with the package is taken under all versions of libraries, so that it is the same on every machine.
"""

import hashlib
import os
import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_path

from .code import ROOT, code_digest

Arrays = Mapping[str, NDArray[Any]]


# Files kept of one thing, by different versions of what makes it.
_VERSIONS = 4
# Below the package: what comes with it.
SHIPPED = Path("data", "kept")


@dataclass(frozen=True, kw_only=True)
class Origin:
    """What arrays are made by: when any of it changes, they are made anew.

    sources    packages or modules of pssf, such as "anatomy" or "xray/spectrum.py", with their tables
    libraries  whose versions count
    facts      what else counts, such as a record, as bytes
    """

    sources: tuple[str, ...]
    libraries: tuple[str, ...] = ()
    facts: bytes = b""


def kept(name: str, origin: Origin, make: Callable[[], Arrays]) -> Arrays:
    """The arrays that `make` gives, from the package or from the cache folder where they stand there.

    name  of the file
    A folder that cannot be written, or a damaged file, costs the time of making them and nothing else.
    """
    # A damaged file can fail anywhere in its readers: zipfile, zlib, numpy.
    with suppress(Exception):
        return _read(_shipped(name, origin))
    folder = _folder()
    if folder is None:
        return make()
    path = folder / f"{name}-{digest_of(origin)[:16]}.npz"
    with suppress(Exception):
        return _read(path)
    arrays = make()
    with suppress(OSError):
        _write(path, arrays)
        # Versions of the package that live side by side do not take each other's away.
        by_age = sorted(folder.glob(f"{name}-*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
        for stale in by_age[_VERSIONS:]:
            stale.unlink()
    return arrays


def ship(name: str, origin: Origin, arrays: Arrays) -> None:
    """Put arrays into the package, instead of those that others before made."""
    for stale in (ROOT / SHIPPED).glob(f"{name}-*.npz"):
        stale.unlink()
    _write(_shipped(name, origin), arrays)


@cache
def digest_of(origin: Origin) -> str:
    """Hash of the code, the tables and the versions of libraries that arrays are made by."""
    made_by = [code_digest(origin.sources), [(name, version(name)) for name in origin.libraries], origin.facts]
    return hashlib.sha256(repr(made_by).encode()).hexdigest()


def _shipped(name: str, origin: Origin) -> Path:
    return ROOT / SHIPPED / f"{name}-{digest_of(replace(origin, libraries=()))[:16]}.npz"


def _folder() -> Path | None:
    named = os.environ.get("PSSF_CACHE_DIR", "")
    if named == "off":
        return None
    return Path(named) if named else user_cache_path("pssf", appauthor=False)


def _read(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def _write(path: Path, arrays: Arrays) -> None:
    """Whole or not at all, whoever else writes the same."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{secrets.token_hex(8)}.part")
    try:
        # By the umask, so that a folder that people share serves them all.
        with open(part, "xb") as handle:
            np.savez_compressed(handle, **arrays)  # type: ignore[arg-type]
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
