"""Hashes of the package's own modules and tables, which identify the code that a result was made by."""

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from platform import node

from ..core.checks import InputError

PACKAGE_ROOT = Path(__file__).resolve().parents[1]
# Suffixes of the files that belong to the package; other files in its folder are ignored.
HASHED_SUFFIXES = (".py", ".toml", ".j2", ".html", ".js", ".css", ".svg", ".npz")
# Files that only document results. They are not hashed: a change of a README must not make a cohort outdated.
DOCUMENTATION_FILES = frozenset({"data/readme.toml", "data/analysis/readme_table.py", "io/readme_tables.py"})

# (table, reader) -> reason why no pixel of a radiograph depends on them. Every other table counts.
TABLES_NOT_AFFECTING_PIXELS = {
    ("benchmark.toml", "analysis/benchmark_table.py"): "description of the benchmark data set",
    ("benchmark_hashes.toml", "analysis/benchmark_table.py"): "hashes that the images are compared with",
    ("ibsi.toml", "analysis/ibsi_table.py"): "IBSI names of features",
    ("landmarks.toml", "analysis/landmark_table.py"): "contours of patients, which simulated knees are compared with",
    (
        "localisation.toml",
        "analysis/localisation_table.py",
    ): "localisation of the joint on a finished radiograph",
    (
        "presets.toml",
        "knees/preset_table.py",
    ): "definitions of cohorts: the plan, and so cohort.json, holds each knee, name and protocol",
    (
        "progress.toml",
        "knees/progression_table.py",
    ): "change of a knee over years: the plan holds each knee after the change",
    (
        "reference.toml",
        "analysis/reference_table.py",
    ): "published values that measured quality and accuracy are compared with",
    ("reporting.toml", "analysis/reporting_table.py"): "checklists in the report of a study",
}


def list_pixel_data_files() -> tuple[str, ...]:
    """List the files below ``data/`` that pixels of a radiograph depend on.

    Returns
    -------
    tuple of str
        Paths relative to the package: all files except `TABLES_NOT_AFFECTING_PIXELS` and `DOCUMENTATION_FILES`.
    """
    apart = DOCUMENTATION_FILES.union(f"data/{name}" for names in TABLES_NOT_AFFECTING_PIXELS for name in names)
    every = [path for path in (PACKAGE_ROOT / "data").rglob("*") if path.suffix in HASHED_SUFFIXES]
    return tuple(sorted({path.relative_to(PACKAGE_ROOT).as_posix() for path in every} - apart))


@cache
def compute_code_hashes(parts: tuple[str, ...] = (".",)) -> dict[str, str]:
    """Compute the hash of the code and tables of each part of the package, without `DOCUMENTATION_FILES`.

    Parameters
    ----------
    parts : tuple of str, default (".",)
        Modules or folders relative to the package, such as "simulation.py" or "data". "." is the whole package.

    Returns
    -------
    dict of str to str
        Part -> first 16 hexadecimal digits of its SHA-256 hash.

    Raises
    ------
    InputError
        If the package has no such part.
    """
    return {part: _hash_files(PACKAGE_ROOT / part) for part in parts}


@cache
def list_installed_packages() -> dict[str, str]:
    """List all installed Python packages.

    Returns
    -------
    dict of str to str
        Name -> version, sorted by name.
    """
    return dict(sorted({(one.metadata["Name"], one.version) for one in distributions()}))


def require_same_code(digests: Mapping[str, str]) -> None:
    """Require the code of the machine where the run started, for workers on other machines.

    Parameters
    ----------
    digests : mapping of str to str
        Part -> hash on the machine where the run started, as returned by `compute_code_hashes`.

    Raises
    ------
    InputError
        If a part differs. The message names the machine and the parts.
    """
    other = format_differing_parts(digests, compute_code_hashes(tuple(digests)))
    if other:
        raise InputError(f"code of pssf on {node()} must be that where the run started, got other code ({other})")


def format_differing_parts(digests: Mapping[str, str], others: Mapping[str, str]) -> str:
    """List the parts whose hashes differ.

    Parameters
    ----------
    digests : mapping of str to str
        Part -> hash.
    others : mapping of str to str
        Part -> hash to compare with.

    Returns
    -------
    str
        Names of the parts that differ or are missing on one side; empty if all agree.
    """
    parts = sorted(set(digests) | set(others))
    return ", ".join(part for part in parts if digests.get(part) != others.get(part))


def _hash_files(path: Path) -> str:
    """Hash the names and contents of a file or of all files of a folder; return 16 hexadecimal digits."""
    if not path.exists():
        raise InputError(f"part must be a module or folder below {PACKAGE_ROOT}, got {path.relative_to(PACKAGE_ROOT)}")
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        name = file.relative_to(PACKAGE_ROOT).as_posix()
        if file.suffix in HASHED_SUFFIXES and name not in DOCUMENTATION_FILES:
            digest.update(f"{name}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]
