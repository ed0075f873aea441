"""Fields of a knee or of a protocol, listed for users, and knee or protocol with some of them changed."""

import tomllib
from collections.abc import Sequence
from dataclasses import MISSING, fields, replace
from typing import Any, TypeVar

from ..core.checks import InputError, require_choice
from ..data.fields import field_laws
from ..data.shapes import shape_table
from .knee import MOST_CYSTS, MOST_SD, Knee, knee_from, knee_table
from .protocol import Protocol, protocol_from, protocol_table

T = TypeVar("T", bound=Knee | Protocol)
_KINDS: dict[str, type[Knee] | type[Protocol]] = {"knee": Knee, "protocol": Protocol}


def field_rows(kind: str) -> list[dict[str, str]]:
    """One row a field: field, what it is, unit, what is allowed, default ("" where it must be given), source.

    kind  "knee" or "protocol"; of a knee's lists of osteophytes, cysts and scores of shape the entries follow
    """
    laws = field_laws(kind)
    rows = [_row(field.name, laws[field.name], _default(field)) for field in fields(_KINDS[kind]) if field.name in laws]
    if kind == "protocol":
        return rows
    for each in ("osteophyte", "cyst"):
        rows += [_row(f"{each}s.{name}", law, "") for name, law in field_laws(each).items()]
    modes = [mode.name for mode in shape_table().modes]
    what = f"scores of the bones' shape, SD from people's mean, in this order: {', '.join(modes)}"
    allowed = f"up to {len(modes)} numbers, each {-MOST_SD:g} to {MOST_SD:g}"
    return [*rows, {"field": "shape", "what": what, "unit": "SD", "allowed": allowed, "default": "[]", "source": ""}]


def _row(name: str, law: Any, default: str) -> dict[str, str]:
    said = {"what": law.what, "unit": law.unit, "allowed": law.allowed, "source": law.source}
    return {"field": name, "default": default, **said}


def _default(field: Any) -> str:
    return "" if field.default is MISSING else "none" if field.default is None else str(field.default)


def knee_template() -> str:
    """A TOML file of the default knee, every field with what it is, its unit and what is allowed."""
    lines = ["# A knee for `pssf simulate --knee FILE`. A field that is left out has the value that stands here."]
    given = knee_table(Knee())
    for row in field_rows("knee"):
        if row["field"] not in field_laws("knee"):
            continue
        unit = f", {row['unit']}" if row["unit"] else ""
        lines += ["", f"# {row['what']}{unit}; {row['allowed']}"]
        value = given[row["field"]]
        shown = f'"{value}"' if isinstance(value, str) else value
        # None, and what is made from other fields where it is not given.
        computed = row["default"] == "none"
        lines.append(f"# {row['field']} = {0 if value is None else shown}" if computed else f"{row['field']} = {shown}")
    lines += [
        "",
        "# scores of the bones' shape, SD: see `pssf knees`",
        "shape = []",
        "",
        "# one table a lip or spike; place and curve_deg may be left out",
        'osteophytes = []  # such as [{ site = "medial_tibia", size_mm = 2.0, place = 0.0, curve_deg = 0.0 }]',
        "",
        f"# at most {MOST_CYSTS}",
        'cysts = []  # such as [{ site = "medial_tibia", diameter_mm = 4.0, place = 0.0, outward = 0.5 }]',
    ]
    return "\n".join(lines) + "\n"


def changes(settings: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fields of a knee and fields of a protocol to change, from texts such as "mas=2".

    settings  FIELD=VALUE; knee.FIELD or protocol.FIELD where both have it. A value is as in TOML; text may go without
              quotation marks, and none is no value
    raises    InputError for an unknown field, one that both have, one that is given twice, or text without "="
    """
    wanted: dict[str, dict[str, Any]] = {"knee": {}, "protocol": {}}
    names = {kind: [field.name for field in fields(of)] for kind, of in _KINDS.items()}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InputError(f"set = {setting!r}; allowed: FIELD=VALUE, such as mas=2")
        kind, dot, field = name.strip().rpartition(".")
        kinds = [kind] if dot else [kind for kind in _KINDS if field in names[kind]]
        if dot:
            require_choice("set", kind, tuple(_KINDS))
        if len(kinds) > 1:
            raise InputError(f"set = {field!r}, of a knee and of a protocol; allowed: knee.{field} or protocol.{field}")
        require_choice("set", field, names[kinds[0]] if kinds else [*names["protocol"], *names["knee"]])
        if field in wanted[kinds[0]]:
            raise InputError(f"set = {name!r}, again; allowed: each once")
        wanted[kinds[0]][field] = _value(text.strip())
    return wanted["knee"], wanted["protocol"]


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        return text


def with_changes(of: T, given: dict[str, Any]) -> T:
    """A knee or a protocol with other values in some fields, checked as it would be from a file.

    raises  InputError for a value that is refused
    """
    if not given:
        return of
    kind = "knee" if isinstance(of, Knee) else "protocol"
    laws = field_laws(kind)
    optional = {name for name, law in laws.items() if law.optional}
    table = {name: None if value == "none" and name in optional else value for name, value in given.items()}
    if isinstance(of, Knee):
        return replace(of, **_parts(table))  # type: ignore[return-value]
    return protocol_from({**protocol_table(of), **table}, "set")  # type: ignore[return-value]


def _parts(table: dict[str, Any]) -> dict[str, Any]:
    """Osteophytes and cysts of tables."""
    whole = knee_from(table, "set")
    return {name: getattr(whole, name) if isinstance(value, list) else value for name, value in table.items()}
