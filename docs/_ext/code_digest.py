"""Compute digests of the code and data on which a measured table depends."""

import ast
import hashlib
import json
import tomllib
from functools import cache
from pathlib import Path


@cache
def load_package(checkout: Path) -> dict[str, tuple[str, frozenset[str]]]:
    """Parse every module of the package once.

    Parameters
    ----------
    checkout : Path
        Source folder that contains ``pssf``.

    Returns
    -------
    dict of str to (str, frozenset of str) tuple
        SHA-256 of the code of each module, and names of the modules that it imports, keyed by module name. Comments,
        docstrings and formatting have no effect on the hash.

    Raises
    ------
    ValueError
        If the folder contains no package ``pssf``.
    """
    paths = sorted((checkout / "pssf").rglob("*.py"))
    if not paths:
        raise ValueError(f"checkout must be a source folder that contains pssf, got {checkout}")
    modules = {_name_module(path.relative_to(checkout)): path for path in paths}
    parsed = {}
    for name, path in modules.items():
        tree = ast.parse(path.read_bytes())
        imported = _find_imports(tree, name, path.name == "__init__.py")
        # `from package import name` imports a module of the package, or a name that its __init__.py defines.
        reached = {full if full in modules else full.rpartition(".")[0] for full in imported} & modules.keys()
        _drop_docstrings(tree)
        parsed[name] = (hashlib.sha256(ast.dump(tree).encode()).hexdigest(), frozenset(reached))
    return parsed


def compute_code_digest(checkout: Path, measured_by: tuple[str, ...]) -> str:
    """Compute the digest of the given modules and of all modules that they import, directly or indirectly.

    Parameters
    ----------
    checkout : Path
        Source folder.
    measured_by : tuple of str
        Modules that measure a table.

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.

    Raises
    ------
    ValueError
        If `measured_by` names a module that the package does not have.
    """
    package = load_package(checkout)
    reached = list_reached_modules(checkout, measured_by)
    return hashlib.sha256("".join(f"{name} {package[name][0]}\n" for name in reached).encode()).hexdigest()


def list_reached_modules(checkout: Path, measured_by: tuple[str, ...]) -> list[str]:
    """List the given modules and all modules that they import, directly or indirectly.

    Parameters
    ----------
    checkout : Path
        Source folder.
    measured_by : tuple of str
        Modules whose imports are followed.

    Returns
    -------
    list of str
        Names of the modules, sorted.

    Raises
    ------
    ValueError
        If `measured_by` names a module that the package does not have.
    """
    package = load_package(checkout)
    waiting, reached = list(measured_by), set()
    while waiting:
        name = waiting.pop()
        if name not in package:
            raise ValueError(f"measured_by must name modules of {checkout / 'pssf'}, got {name}")
        if name not in reached:
            reached.add(name)
            waiting += package[name][1]
    return sorted(reached)


@cache
def compute_data_digest(checkout: Path) -> str:
    """Compute the digest of the data files of the package and of the protocols.

    TOML files are compared by their values, so comments have no effect.

    Parameters
    ----------
    checkout : Path
        Source folder.

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.
    """
    digest = hashlib.sha256()
    for folder in ("pssf/data", "protocols"):
        for path in sorted((checkout / folder).rglob("*")):
            if path.suffix in (".toml", ".npz"):
                digest.update(f"{path.relative_to(checkout).as_posix()}\n".encode() + _read_values(path))
    return digest.hexdigest()


def _read_values(path: Path) -> bytes:
    """Read a data file as bytes; the values of a TOML file are converted to JSON."""
    content = path.read_bytes()
    if path.suffix != ".toml":
        return content
    return json.dumps(tomllib.loads(content.decode()), default=str).encode()


def _name_module(path: Path) -> str:
    """Return the module name of a file, such as ``pssf.io`` for ``pssf/io/__init__.py``."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _find_imports(tree: ast.Module, module: str, is_package: bool) -> set[str]:
    """List the full names that a module imports, also inside functions, except imports for type checkers."""
    package = module.split(".") if is_package else module.split(".")[:-1]
    names: set[str] = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = [*base, *(node.module or "").split(".")] if node.module else base
            names |= {".".join([*base, alias.name]) for alias in node.names}
    return names


def _drop_docstrings(tree: ast.Module) -> None:
    """Remove the docstrings of a module, its classes and its functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                del node.body[0]
