"""Which code something was made by: hashes of the package's own modules and tables."""

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from platform import node

from ..core.checks import InputError

ROOT = Path(__file__).resolve().parents[1]
# What of the package is read by Python or by its modules; anything else there is not its own.
SUFFIXES = (".py", ".toml", ".j2", ".html", ".js", ".css", ".svg", ".npz")
# What only tells of results: nobody's cohort is made anew for a sentence of a README.
TELLING = frozenset({"data/readme.toml", "data/readmes.py", "io/readme.py"})

# Tables and their readers that no pixel of a radiograph hangs on, and why; a table that is not among them counts.
NOT_OF_PIXELS = {
    ("benchmark.toml", "benchmark.py"): "what is said of a frozen data set",
    ("benchmark_hashes.toml", "benchmark.py"): "hashes that its images are held against",
    ("ibsi.toml", "ibsi.py"): "values that features are held against",
    ("landmarks.toml", "landmarks.py"): "people's contours, beside which drawn knees are measured",
    ("localisation.toml", "localisation.py"): "how the joint is looked for on a radiograph that is there",
    ("presets.toml", "presets.py"): "cohorts to ask for: a plan, and so cohort.json, has each knee, name and protocol",
    ("progress.toml", "progress.py"): "how a knee changes over years: a plan has each knee as it is then",
    ("reference.toml", "references.py"): "published values, beside which quality and accuracy are measured",
    ("reporting.toml", "reporting.py"): "checklists for a study's report",
}


def data_of_pixels() -> tuple[str, ...]:
    """The parts of data/ that a radiograph's pixels hang on, each by itself: all but `NOT_OF_PIXELS` and `TELLING`."""
    apart = TELLING.union(f"data/{name}" for names in NOT_OF_PIXELS for name in names)
    every = [path for path in (ROOT / "data").iterdir() if path.suffix in SUFFIXES or path.is_dir()]
    names = [path.relative_to(ROOT).as_posix() for path in every if path.name != "__pycache__"]
    return tuple(sorted(set(names) - apart))


@cache
def code_digest(parts: tuple[str, ...] = (".",)) -> dict[str, str]:
    """part -> hash of the code and tables in it, but for those of `TELLING`

    parts   modules or folders as they are called below pssf/, such as "simulation.py" or "data"; ".": all of them
    raises  InputError for a part that the package does not have
    """
    return {part: _hash(ROOT / part) for part in parts}


@cache
def installed() -> dict[str, str]:
    """name -> version of everything that is installed"""
    return dict(sorted({(one.metadata["Name"], one.version) for one in distributions()}))


def require_code(digests: Mapping[str, str]) -> None:
    """Refuse to work with other code than where the run started, as a worker on another machine may have it.

    digests  of `code_digest`, there
    raises   InputError naming the machine and the parts that differ
    """
    other = differing(digests, code_digest(tuple(digests)))
    if other:
        raise InputError(f"on {node()}: other code of pssf ({other}); allowed: the code where the run started")


def differing(digests: Mapping[str, str], others: Mapping[str, str]) -> str:
    """The parts whose hashes are not the same, as they are named in a refusal; "" where all are."""
    parts = sorted(set(digests) | set(others))
    return ", ".join(part for part in parts if digests.get(part) != others.get(part))


def _hash(path: Path) -> str:
    if not path.exists():
        raise InputError(f"part {path.relative_to(ROOT)} of pssf is missing; allowed: a module or folder below {ROOT}")
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        name = file.relative_to(ROOT).as_posix()
        if file.suffix in SUFFIXES and name not in TELLING:
            digest.update(f"{name}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]
