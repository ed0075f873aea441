"""List the fields of a knee or protocol for users, and change fields by name."""

import tomllib
from collections.abc import Sequence
from dataclasses import MISSING, fields, replace
from typing import Any, TypeVar

from ..core.checks import InputError, require_choice
from ..data.anatomy.shape_table import load_shape_model
from ..data.knees.field_definitions import load_field_specs
from .detector import Detector
from .knee import (
    MAX_CYSTS,
    MAX_SHAPE_SD,
    Knee,
    knee_from_dict,
    knee_to_dict,
)
from .protocol import Protocol, protocol_from_dict, protocol_to_dict

T = TypeVar("T", bound=Knee | Protocol)
# Dataclass of each parameter set, keyed by the name of the parameter set.
_KINDS: dict[str, type[Knee] | type[Protocol]] = {"knee": Knee, "protocol": Protocol}
# Dataclasses whose fields are listed.
_LISTED: dict[str, Any] = {**_KINDS, "detector": Detector}


def list_fields(kind: str) -> list[dict[str, str]]:
    """List the fields of a knee, protocol or detector with their units, allowed values, defaults and sources.

    Parameters
    ----------
    kind : {"knee", "protocol", "detector"}
        Parameter set whose fields are listed.

    Returns
    -------
    list of dict of str to str
        One row per field with the keys ``field``, ``what`` (meaning of the field), ``unit``, ``allowed``, ``default``
        ("" if the field is required) and ``source``. For a knee, the last rows describe osteophyte fields, cyst fields
        and shape scores.
    """
    laws = load_field_specs(kind)
    rows = [
        _make_row(field.name, laws[field.name], _format_default(field))
        for field in fields(_LISTED[kind])
        if field.name in laws
    ]
    if kind != "knee":
        return rows
    for each in ("osteophyte", "cyst"):
        rows += [_make_row(f"{each}s.{name}", law, "") for name, law in load_field_specs(each).items()]
    modes = [mode.name for mode in load_shape_model().modes]
    what = f"scores of the bone shape modes, in SD from the population mean, in the order {', '.join(modes)}"
    allowed = f"up to {len(modes)} numbers, each {-MAX_SHAPE_SD:g} to {MAX_SHAPE_SD:g}"
    return [*rows, {"field": "shape", "what": what, "unit": "SD", "allowed": allowed, "default": "[]", "source": ""}]


def _make_row(name: str, law: Any, default: str) -> dict[str, str]:
    """Make the table row of one field from its specification."""
    said = {"what": law.description, "unit": law.unit, "allowed": law.allowed_text, "source": law.source}
    return {"field": name, "default": default, **said}


def _format_default(field: Any) -> str:
    """Format the default of a dataclass field: "" if the field is required, "none" if the default is None."""
    return "" if field.default is MISSING else "none" if field.default is None else str(field.default)


def format_knee_template() -> str:
    """Format the default knee as TOML, with the meaning, unit and allowed values above every field.

    Returns
    -------
    str
        Content of a TOML file for ``pssf simulate --knee FILE``.
    """
    lines = ["# Knee for `pssf simulate --knee FILE`. A missing field gets the default value in this template."]
    given = knee_to_dict(Knee())
    for row in list_fields("knee"):
        if row["field"] not in load_field_specs("knee"):
            continue
        unit = f", {row['unit']}" if row["unit"] else ""
        lines += ["", f"# {row['what']}{unit}; {row['allowed']}"]
        value = given[row["field"]]
        shown = f'"{value}"' if isinstance(value, str) else value
        # A field whose default is None is written as a comment, because TOML has no null value.
        computed = row["default"] == "none"
        lines.append(f"# {row['field']} = {0 if value is None else shown}" if computed else f"{row['field']} = {shown}")
    lines += [
        "",
        "# scores of the bone shape modes, in SD; `pssf knees` lists the modes",
        "shape = []",
        "",
        "# one table per osteophyte; place and curve_deg are optional",
        'osteophytes = []  # example: [{ site = "medial_tibia", size_mm = 2.0, place = 0.0, curve_deg = 0.0 }]',
        "",
        f"# at most {MAX_CYSTS} cysts, one table per cyst; place and outward are optional",
        'cysts = []  # example: [{ site = "medial_tibia", diameter_mm = 4.0, place = 0.0, outward = 0.5 }]',
    ]
    return "\n".join(lines) + "\n"


def parse_settings(settings: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Parse settings such as "mas=2" into changes of knee and protocol fields.

    Parameters
    ----------
    settings : sequence of str
        Settings of the form ``FIELD=VALUE``. A field name that exists in both knee and protocol is written
        ``knee.FIELD`` or ``protocol.FIELD``. Values use TOML syntax. Text needs no quotation marks, and ``none`` means
        None.

    Returns
    -------
    knee_fields : dict of str to object
        New value of each knee field, keyed by field name.
    protocol_fields : dict of str to object
        New value of each protocol field, keyed by field name.

    Raises
    ------
    InputError
        If a setting has no "=", or names an unknown field, an ambiguous field, or the same field twice.
    """
    wanted: dict[str, dict[str, Any]] = {"knee": {}, "protocol": {}}
    names = {kind: [field.name for field in fields(of)] for kind, of in _KINDS.items()}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InputError(f"set must be FIELD=VALUE, such as mas=2, got {setting!r}")
        kind, dot, field = name.strip().rpartition(".")
        kinds = [kind] if dot else [kind for kind in _KINDS if field in names[kind]]
        if dot:
            require_choice("set", kind, tuple(_KINDS))
        if len(kinds) > 1:
            raise InputError(f"set must name knee.{field} or protocol.{field}, got {field!r}: the name is ambiguous")
        require_choice("set", field, names[kinds[0]] if kinds else [*names["protocol"], *names["knee"]])
        if field in wanted[kinds[0]]:
            raise InputError(f"set must name each field once, got {name!r} twice")
        wanted[kinds[0]][field] = _parse_value(text.strip())
    return wanted["knee"], wanted["protocol"]


def _parse_value(text: str) -> Any:
    """Parse a value as TOML; return the text unchanged if it is not valid TOML."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        return text


def apply_settings(target: T, settings: dict[str, Any]) -> T:
    """Replace fields of a knee or protocol and check the result.

    Parameters
    ----------
    target : Knee or Protocol
        Knee or protocol to change.
    settings : dict of str to object
        New values keyed by field name, as returned by `parse_settings`. The text ``none`` sets an optional field to
        None.

    Returns
    -------
    Knee or Protocol
        Changed copy, or `target` itself if `settings` is empty.

    Raises
    ------
    InputError
        If a field is unknown or a value is not allowed.
    """
    if not settings:
        return target
    kind = "knee" if isinstance(target, Knee) else "protocol"
    laws = load_field_specs(kind)
    optional = {name for name, law in laws.items() if law.optional}
    table = {name: None if value == "none" and name in optional else value for name, value in settings.items()}
    if isinstance(target, Knee):
        return replace(target, **_parse_items(table))  # type: ignore[return-value]
    return protocol_from_dict({**protocol_to_dict(target), **table}, "set")  # type: ignore[return-value]


def _parse_items(table: dict[str, Any]) -> dict[str, Any]:
    """Convert osteophyte and cyst tables to `Osteophyte` and `Cyst`; leave other values unchanged."""
    whole = knee_from_dict(table, "set")
    return {name: getattr(whole, name) if isinstance(value, list) else value for name, value in table.items()}
