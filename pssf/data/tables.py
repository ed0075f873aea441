"""The package's data files and protocols by name; read once, then kept."""

import os
import tomllib
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any

from ..core.checks import InputError, require_path, shown
from .userfiles import parsed, read_text, refusing

_MOST_TOML = 2**20  # bytes of a file of parameters
_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def data(name: str) -> dict[str, Any]:
    """The TOML table pssf/data/<name>.toml."""
    return tomllib.loads((_PACKAGE / "data" / f"{name}.toml").read_text(encoding="utf-8"))


def protocol_names() -> list[str]:
    """Names of the protocols that come with the package."""
    return sorted(path.stem for path in _protocol_folder().glob("*.toml"))


def read_protocol(name_or_path: str | PathLike[str]) -> tuple[dict[str, Any], str]:
    """Fields of a protocol file, with those of its base that it does not give, and what to call it.

    raises  InputError for an unknown name, a file that is not readable TOML, or a base that leads back to itself
    """
    fields: dict[str, Any] = {}
    path = first = _protocol_path(name_or_path)
    seen: list[Path] = []
    while True:
        with refusing(path, "a readable TOML file"):
            here = Path(os.path.realpath(path))
        if here in seen:
            raise InputError(f"protocol {first.name}: base leads back to {path.name}; allowed: a base without a circle")
        seen.append(here)
        fields = read_toml(path) | fields
        base = fields.pop("base", None)
        if base is None:
            return fields, f"protocol {first.name}"
        if not isinstance(base, str):
            raise InputError(f"protocol {path.name}: base = {base!r}; allowed: the name or path of a protocol")
        path = path.parent / base if base.endswith(".toml") else _protocol_path(base)


def _protocol_path(name_or_path: str | PathLike[str]) -> Path:
    path = require_path(name_or_path, "protocol")
    if path.suffix == ".toml":
        return path
    if str(name_or_path) not in protocol_names():
        allowed = ", ".join(protocol_names())
        raise InputError(f"protocol = {str(name_or_path)!r}; allowed: {allowed}, or the path of a .toml file")
    return _protocol_folder() / f"{name_or_path}.toml"


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a mapping.

    raises  InputError for a file that is missing, unreadable or not TOML
    """
    allowed = "a readable TOML file"
    table: dict[str, Any] = parsed(
        path, read_text(path, _MOST_TOML, allowed), tomllib.loads, fault="not TOML", allowed=allowed
    )
    _require_known_size(table, path)
    return table


def _require_known_size(value: Any, path: Path) -> None:
    """Refuse integers beyond 64 bits, as TOML has none (specification 1.0, Integer)."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    for part in parts:
        _require_known_size(part, path)
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InputError(f"file {path}: an integer must be within 64 bits, got {shown(value)}")


def _protocol_folder() -> Path:
    packaged = _PACKAGE / "protocols"
    return packaged if packaged.is_dir() else _PACKAGE.parent / "protocols"
