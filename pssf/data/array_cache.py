"""Cache computed arrays, either shipped with the package or stored in the user's cache folder.

The cached arrays depend only on the package, and take seconds to compute. The file name contains a digest of the code,
tables and library versions that made the arrays, so an outdated file is never used. Shipped arrays do not depend on
library versions, so they are the same on every machine. The environment variable ``PSSF_CACHE_DIR`` specifies another
cache folder; the value "off" disables the cache.
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

from .code_hash import PACKAGE_ROOT, compute_code_hashes

Arrays = Mapping[str, NDArray[Any]]


# Maximum number of cached files per name, from different versions of code, tables or libraries.
_MAX_VERSIONS = 4
# Folder of the shipped arrays, relative to the package.
PACKAGED_FOLDER = Path("data", "kept")


@dataclass(frozen=True, kw_only=True)
class CacheKey:
    """Identify the code, libraries and other input of cached arrays; after any change, the arrays are recomputed.

    Parameters
    ----------
    sources : tuple of str
        Subpackages, modules and tables of pssf that affect the arrays, such as "anatomy" or "xray/spectrum.py".
    libraries : tuple of str, default ()
        Names of libraries whose versions affect the arrays.
    facts : bytes, default b""
        Other input as bytes, such as an encoded record.
    """

    sources: tuple[str, ...]
    libraries: tuple[str, ...] = ()
    facts: bytes = b""


def load_or_make_arrays(name: str, origin: CacheKey, make: Callable[[], Arrays]) -> Arrays:
    """Load arrays from the package or from the cache folder; compute and store missing arrays.

    If a file is damaged or the cache folder is not writable, the arrays are computed and no error is raised.

    Parameters
    ----------
    name : str
        Name of the file, without digest and suffix.
    origin : CacheKey
        Code, libraries and other input on which the arrays depend.
    make : callable
        Function without arguments that computes the arrays.

    Returns
    -------
    mapping of str to array
        Arrays, keyed by name.
    """
    # All exceptions are suppressed, because a damaged file can raise any error in zipfile, zlib or numpy.
    with suppress(Exception):
        return _read_arrays(_packaged_path(name, origin))
    folder = _cache_folder()
    if folder is None:
        return make()
    path = folder / f"{name}-{compute_cache_digest(origin)[:16]}.npz"
    with suppress(Exception):
        return _read_arrays(path)
    arrays = make()
    with suppress(OSError):
        _write_arrays(path, arrays)
        # Several files per name are kept, so that several installed versions of the package can share the folder.
        by_age = sorted(folder.glob(f"{name}-*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
        for stale in by_age[_MAX_VERSIONS:]:
            stale.unlink()
    return arrays


def save_to_package(name: str, origin: CacheKey, arrays: Arrays) -> None:
    """Store arrays in the package and delete earlier files with the same name.

    Parameters
    ----------
    name : str
        Name of the file, without digest and suffix.
    origin : CacheKey
        Code, libraries and other input on which the arrays depend.
    arrays : mapping of str to array
        Arrays of any shape and unit, keyed by name.
    """
    for stale in (PACKAGE_ROOT / PACKAGED_FOLDER).glob(f"{name}-*.npz"):
        stale.unlink()
    _write_arrays(_packaged_path(name, origin), arrays)


@cache
def compute_cache_digest(origin: CacheKey) -> str:
    """Compute the digest of the code, tables, library versions and other input in a cache key.

    Parameters
    ----------
    origin : CacheKey
        Code, libraries and other input on which the arrays depend.

    Returns
    -------
    str
        SHA-256 digest, in hexadecimal digits.
    """
    made_by = [compute_code_hashes(origin.sources), [(name, version(name)) for name in origin.libraries], origin.facts]
    return hashlib.sha256(repr(made_by).encode()).hexdigest()


def _packaged_path(name: str, origin: CacheKey) -> Path:
    """Return the path of shipped arrays; the digest in its name does not include library versions."""
    return PACKAGE_ROOT / PACKAGED_FOLDER / f"{name}-{compute_cache_digest(replace(origin, libraries=()))[:16]}.npz"


def _cache_folder() -> Path | None:
    """Return the cache folder, or None if the cache is disabled."""
    named = os.environ.get("PSSF_CACHE_DIR", "")
    if named == "off":
        return None
    return Path(named) if named else user_cache_path("pssf", appauthor=False)


def _read_arrays(path: Path) -> Arrays:
    """Read all arrays of an .npz file; pickled objects are not allowed."""
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def _write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a temporary file and rename the file, so that no process reads a partial file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{secrets.token_hex(8)}.part")
    try:
        # The file is opened directly, without tempfile, so that the umask sets its permissions and several users can
        # share it.
        with open(part, "xb") as handle:
            np.savez_compressed(handle, **arrays)  # type: ignore[arg-type]
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
