"""Compute digests of the code and data on which a measured table depends."""

import ast
import hashlib
import json
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

# Keys of texts for readers in TOML files; the texts have no effect on a digest, like comments.
_TEXT_KEYS = {"description", "label", "source"}


@dataclass(frozen=True)
class Module:
    """Parsed module.

    Attributes
    ----------
    code_hash : str
        SHA-256 of the code; comments, docstrings and formatting have no effect.
    imports : frozenset of str
        Names of the modules of the package that it imports.
    tables : frozenset of str
        Names of the tables of ``pssf/data`` that it reads with ``load_data_table``.
    """

    code_hash: str
    imports: frozenset[str]
    tables: frozenset[str]


@cache
def load_package(checkout: Path) -> dict[str, Module]:
    """Parse every module of the package once.

    Parameters
    ----------
    checkout : Path
        Source folder that contains ``pssf``.

    Returns
    -------
    dict of str to Module
        Hash, imports and tables of each module, keyed by module name.

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
        code_hash = hashlib.sha256(ast.dump(tree).encode()).hexdigest()
        parsed[name] = Module(code_hash, frozenset(reached), _find_tables(tree))
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
    return hashlib.sha256("".join(f"{name} {package[name].code_hash}\n" for name in reached).encode()).hexdigest()


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
            waiting += package[name].imports
    return sorted(reached)


def compute_data_digest(checkout: Path, measured_by: tuple[str, ...]) -> str:
    """Compute the digest of the data files of the package and of the protocols.

    Left out are tables that only modules read which the given modules do not import, and arrays that are kept because
    the code of the package takes minutes to compute them. TOML files are compared by their values, so comments have no
    effect; nor have descriptions, labels and sources.

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
    reached = {name for module in list_reached_modules(checkout, measured_by) for name in package[module].tables}
    unread = {f"pssf/data/{name}.toml" for module in package.values() for name in module.tables - reached}
    values = _load_values(checkout)
    return hashlib.sha256("".join(text for name, text in values.items() if name not in unread).encode()).hexdigest()


@cache
def _load_values(checkout: Path) -> dict[str, str]:
    """Load every TOML file of the data and protocols once, as its name and its values without texts for readers."""
    values = {}
    for folder in ("pssf/data", "protocols"):
        for path in sorted((checkout / folder).rglob("*.toml")):
            name = path.relative_to(checkout).as_posix()
            content = _drop_texts(tomllib.loads(path.read_text(encoding="utf-8")))
            values[name] = f"{name}\n{json.dumps(content, default=str)}"
    return values


def _drop_texts(value: Any) -> Any:
    """Remove texts for readers from the values of a TOML file."""
    if isinstance(value, dict):
        return {key: _drop_texts(one) for key, one in value.items() if not (key in _TEXT_KEYS and isinstance(one, str))}
    return [_drop_texts(one) for one in value] if isinstance(value, list) else value


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


def _find_tables(tree: ast.Module) -> frozenset[str]:
    """List the names of tables that calls of ``load_data_table`` contain."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args)
    return frozenset(
        call.args[0].value
        for call in calls
        if isinstance(call.func, ast.Name)
        and call.func.id == "load_data_table"
        and isinstance(call.args[0], ast.Constant)
    )


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
