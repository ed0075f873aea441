"""Compute hashes of the modules and tables of the package, which identify the code that made a result."""

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from platform import node

from ..core.checks import InputError

PACKAGE_ROOT = Path(__file__).resolve().parents[1]
# Suffixes of the files that are hashed; other files in the package folder are ignored.
HASHED_SUFFIXES = (".py", ".toml", ".j2", ".html", ".js", ".css", ".svg", ".npz", ".json", ".onnx")
# Folder of the networks that read finished radiographs, which do not affect pixels.
READER_FOLDER = "data/reader"
# Reasons why the pixels of a radiograph do not depend on a table, keyed by the table and the module that reads it.
# Pixels may depend on all other tables.
TABLES_NOT_AFFECTING_PIXELS = {
    ("benchmark.toml", "analysis/benchmark_table.py"): "description of the benchmark data set",
    ("benchmark_hashes.toml", "analysis/benchmark_table.py"): "published hashes of images, for comparison",
    ("ibsi.toml", "analysis/ibsi_table.py"): "IBSI names of features",
    ("landmarks.toml", "analysis/landmark_table.py"): "contour landmarks of patients, for comparison with simulations",
    (
        "localisation.toml",
        "analysis/localisation_table.py",
    ): "localisation of the joint on finished radiographs",
    (
        "presets.toml",
        "knees/preset_table.py",
    ): "definitions of cohorts; the plan (cohort.json) contains every knee, name and protocol",
    (
        "progress.toml",
        "knees/progression_table.py",
    ): "change of a knee over years; the plan contains every knee after the change",
    (
        "reference.toml",
        "analysis/reference_table.py",
    ): "published reference values, for comparison with measured image quality and measurement accuracy",
    ("reporting.toml", "analysis/reporting_table.py"): "checklists in the report of a study",
}


def list_pixel_data_files() -> tuple[str, ...]:
    """List the files in ``data/`` that may affect the pixels of a radiograph.

    Returns
    -------
    tuple of str
        Paths relative to the package: all files except `TABLES_NOT_AFFECTING_PIXELS` and the networks of the reader.
    """
    apart = {f"data/{name}" for names in TABLES_NOT_AFFECTING_PIXELS for name in names}
    every = {
        path.relative_to(PACKAGE_ROOT).as_posix()
        for path in (PACKAGE_ROOT / "data").rglob("*")
        if path.suffix in HASHED_SUFFIXES
    }
    return tuple(sorted(path for path in every - apart if not path.startswith(f"{READER_FOLDER}/")))


@cache
def compute_code_hashes(parts: tuple[str, ...] = (".",)) -> dict[str, str]:
    """Compute one hash for each specified module or folder, from its code and tables.

    Parameters
    ----------
    parts : tuple of str, default (".",)
        Modules or folders relative to the package, such as "simulation.py" or "data". "." is the whole package.

    Returns
    -------
    dict of str to str
        First 16 hexadecimal digits of the SHA-256 hash of each module or folder.

    Raises
    ------
    InputError
        If the package does not contain one of the modules or folders.
    """
    return {part: _hash_files(PACKAGE_ROOT / part) for part in parts}


@cache
def list_installed_packages() -> dict[str, str]:
    """List all installed Python packages.

    Returns
    -------
    dict of str to str
        Version of each package, sorted by package name.
    """
    return dict(sorted({(one.metadata["Name"], one.version) for one in distributions()}))


def require_same_code(digests: Mapping[str, str]) -> None:
    """Require that this machine has the same code as the machine that started the run.

    Parameters
    ----------
    digests : mapping of str to str
        Hash of each module or folder on the machine that started the run, from `compute_code_hashes`.

    Raises
    ------
    InputError
        If a hash differs. The message names the machine and the modules or folders that differ.
    """
    other = format_differing_parts(digests, compute_code_hashes(tuple(digests)))
    if other:
        raise InputError(f"code of pssf on {node()} must be the code that started the run, got other code ({other})")


def format_differing_parts(digests: Mapping[str, str], others: Mapping[str, str]) -> str:
    """List the modules and folders whose hashes differ.

    Parameters
    ----------
    digests : mapping of str to str
        Hash of each module or folder on one machine or in one version.
    others : mapping of str to str
        Hash of each module or folder on the other machine or in the other version.

    Returns
    -------
    str
        Names of modules and folders that differ or are missing in one of the two mappings; empty if all agree.
    """
    parts = sorted(set(digests) | set(others))
    return ", ".join(part for part in parts if digests.get(part) != others.get(part))


def _hash_files(path: Path) -> str:
    """Hash the names and contents of a file or of all files of a folder; return 16 hexadecimal digits."""
    if not path.exists():
        raise InputError(f"part must be a module or folder below {PACKAGE_ROOT}, got {path.relative_to(PACKAGE_ROOT)}")
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.suffix in HASHED_SUFFIXES:
            digest.update(f"{file.relative_to(PACKAGE_ROOT).as_posix()}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]
