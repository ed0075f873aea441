"""Read the TOML tables and protocols of the package, and TOML files that the user specifies."""

import os
import tomllib
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any

from ..core.checks import InputError, format_value, require_path
from .user_files import convert_os_errors, parse_text, read_text

# Size limit of TOML files that the user specifies, in bytes (assumed).
_MAX_TOML_BYTES = 2**20
_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def load_data_table(name: str) -> dict[str, Any]:
    """Load the TOML table ``pssf/data/<name>.toml``; later calls return the same object.

    Parameters
    ----------
    name : str
        Name of the table, without suffix.

    Returns
    -------
    dict of str to Any
        Content of the table.
    """
    return tomllib.loads((_PACKAGE / "data" / f"{name}.toml").read_text(encoding="utf-8"))


def list_protocols() -> list[str]:
    """List the names of the protocols that come with the package.

    Returns
    -------
    list of str
        Names, sorted.
    """
    return sorted(path.stem for path in _protocol_folder().glob("*.toml"))


def read_protocol_fields(name_or_path: str | PathLike[str]) -> tuple[dict[str, Any], str]:
    """Read the fields of a protocol file; missing fields are inherited from its base protocol.

    Parameters
    ----------
    name_or_path : str or os.PathLike
        Name of a protocol of the package, or path of a .toml file.

    Returns
    -------
    fields : dict of str to Any
        Value of each field, keyed by field name.
    label : str
        Name of the protocol, shown in error messages.

    Raises
    ------
    InputError
        If the name is unknown, the file is not readable TOML, or the chain of base protocols is circular.
    """
    fields: dict[str, Any] = {}
    path = first = _resolve_protocol_path(name_or_path)
    seen: list[Path] = []
    while True:
        with convert_os_errors(path, "a readable TOML file"):
            here = Path(os.path.realpath(path))
        if here in seen:
            raise InputError(f"bases of protocol {first.name} must not be circular, got {path.name} twice")
        seen.append(here)
        fields = read_toml(path) | fields
        base = fields.pop("base", None)
        if base is None:
            return fields, f"protocol {first.name}"
        if not isinstance(base, str):
            raise InputError(f"base of protocol {path.name} must be the name or path of a protocol, got {base!r}")
        path = path.parent / base if base.endswith(".toml") else _resolve_protocol_path(base)


def _resolve_protocol_path(name_or_path: str | PathLike[str]) -> Path:
    """Return the path of a protocol file from a name or path; raise InputError for an unknown name."""
    path = require_path(name_or_path, "protocol")
    if path.suffix == ".toml":
        return path
    if str(name_or_path) not in list_protocols():
        allowed = ", ".join(list_protocols())
        raise InputError(f"protocol must be {allowed}, or the path of a .toml file, got {str(name_or_path)!r}")
    return _protocol_folder() / f"{name_or_path}.toml"


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : Path
        File of at most 1 MiB.

    Returns
    -------
    dict of str to Any
        Content of the file.

    Raises
    ------
    InputError
        If the file is missing, unreadable or too large, is not TOML, or contains an integer outside the 64-bit range.
    """
    allowed = "a readable TOML file"
    table: dict[str, Any] = parse_text(
        path, read_text(path, _MAX_TOML_BYTES, allowed), tomllib.loads, fault="not TOML", allowed=allowed
    )
    _require_64_bit_integers(table, path)
    return table


def _require_64_bit_integers(value: Any, path: Path) -> None:
    """Raise InputError for integers outside the 64-bit range, which TOML 1.0 does not define."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    for part in parts:
        _require_64_bit_integers(part, path)
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InputError(f"integers of file {path} must be within 64 bits, got {format_value(value)}")


def _protocol_folder() -> Path:
    """Return the folder of the protocols: inside the package, or next to the package in a source checkout."""
    packaged = _PACKAGE / "protocols"
    return packaged if packaged.is_dir() else _PACKAGE.parent / "protocols"
