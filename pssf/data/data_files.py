"""Read the TOML tables and protocols of the package, and TOML files that the user specifies."""

import csv
import os
import tomllib
from collections.abc import Callable, Iterator
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
    first = _resolve_protocol_path(name_or_path)
    fields: dict[str, Any] = {}
    for path, own in _follow_bases(first, "protocol", _resolve_protocol_path):
        fields = _resolve_named_files(own, path) | fields
    return fields, f"protocol {first.name}"


def list_detectors() -> list[str]:
    """List the names of the detectors that come with the package.

    Returns
    -------
    list of str
        Names, in the order of the table.
    """
    return list(load_data_table("detector"))


def read_detector_fields(name_or_path: str | PathLike[str]) -> tuple[dict[str, Any], str]:
    """Read the fields of a detector; fields missing in a file are inherited from its base detector.

    Parameters
    ----------
    name_or_path : str or os.PathLike
        Name of a detector of the package, or path of a .toml file.

    Returns
    -------
    fields : dict of str to Any
        Value of each field, keyed by field name.
    label : str
        Name of the detector, shown in error messages.

    Raises
    ------
    InputError
        If the name is unknown, the file is not readable TOML, or the chain of base detectors is circular.
    """
    path = require_path(name_or_path, "detector")
    if path.suffix != ".toml":
        return _packaged_detector(str(name_or_path)), f"detector {name_or_path}"
    fields: dict[str, Any] = {}
    for _, own in _follow_bases(path, "detector", _packaged_detector):
        fields = own | fields if fields else {"name": path.stem} | own
    return fields, f"detector {path.name}"


def _packaged_detector(name: str) -> dict[str, Any]:
    """Return the fields of a detector of the package; raise InputError for an unknown name."""
    table = load_data_table("detector")
    if name not in table:
        raise InputError(f"detector must be {', '.join(table)}, or the path of a .toml file, got {name!r}")
    return {"name": name, **table[name]}


def _follow_bases(
    first: Path, kind: str, resolve_name: Callable[[str], Path | dict[str, Any]]
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield the path and the fields of a TOML file, of its base, of the base of the base, and so on.

    `resolve_name` converts the name of a base to a path, or to the fields of a base that is not a file.
    """
    path, seen = first, list[Path]()
    while True:
        with convert_os_errors(path, "a readable TOML file"):
            here = Path(os.path.realpath(path))
        if here in seen:
            raise InputError(f"bases of {kind} {first.name} must not be circular, got {path.name} twice")
        seen.append(here)
        fields = read_toml(path)
        base = fields.pop("base", None)
        yield path, fields
        if base is None:
            return
        if not isinstance(base, str):
            raise InputError(f"base of {kind} {path.name} must be the name or path of a {kind}, got {base!r}")
        next_source = path.parent / base if base.endswith(".toml") else resolve_name(base)
        if isinstance(next_source, dict):
            yield path, next_source
            return
        path = next_source


def _resolve_named_files(fields: dict[str, Any], path: Path) -> dict[str, Any]:
    """Make the file names of detector and spectrum in the fields of a protocol file relative to its folder."""
    named = {name: fields[name] for name in ("detector", "spectrum") if isinstance(fields.get(name), str)}
    return fields | {
        name: str(path.parent / file) for name, file in named.items() if name == "spectrum" or file.endswith(".toml")
    }


def read_spectrum(file: Path) -> list[tuple[float, float]]:
    """Read a spectrum from a CSV file with two columns; the first row may contain the names of the columns.

    Parameters
    ----------
    file : Path
        Path of the file.

    Returns
    -------
    list of (float, float)
        Energy in keV, and photons per mm2 and mAs at 1 m, of each bin.

    Raises
    ------
    InputError
        If the file cannot be read or does not have two columns of numbers.
    """
    what = "a CSV file of energies in keV and photons per mm2 and mAs at 1 m"
    rows = [row for row in csv.reader(read_text(file, allowed=what).splitlines()) if row]
    try:
        return [(float(kev), float(photons)) for kev, photons in (rows if _is_number(rows[0][0]) else rows[1:])]
    except (ValueError, IndexError) as error:
        raise InputError(f"file {file} must be {what}, got: {error}") from None


def _is_number(text: str) -> bool:
    """Return whether a cell of a table is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


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
