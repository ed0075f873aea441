"""What the page shows: fields with unit, range and sentence, tables of grades, protocols, presets; JSON-ready."""

from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Any

from ..data.explore import Explored, Group, explored
from ..data.fields import FieldLaw, field_laws
from ..data.grade_tables import grade_table, grade_tables
from ..data.shapes import shape_table
from ..data.tables import protocol_names
from ..model.knee import MOST_CYSTS, MOST_SD, Cyst, Knee, Osteophyte, knee_from, knee_table
from ..model.protocol import load_protocol, protocol_table

# Whole numbers that a browser would round are told as text.
LARGEST_EXACT = 2**53 - 1
# No larger detector is shown: with all that is kept it takes some gigabytes.
MOST_PIXELS = 4096
_ITEMS: dict[str, type[Any]] = {"osteophyte": Osteophyte, "cyst": Cyst}


@cache
def listing() -> dict[str, Any]:
    """All that the page is built from."""
    table, laws = explored(), {kind: field_laws(kind) for kind in ("knee", "protocol", *_ITEMS)}
    optional = {name for name, law in laws["knee"].items() if law.optional}
    protocols = {name: load_protocol(name) for name in protocol_names()}
    return {
        "knee": [_group(group, laws["knee"], table) for group in table.knee],
        "protocol": [_group(group, laws["protocol"], table) for group in table.protocol],
        "items": {f"{kind}s": _fields(of, laws[kind], table) for kind, of in _ITEMS.items()},
        "most": {"osteophytes": 12, "cysts": MOST_CYSTS},
        "shape": [
            {"name": mode.name, "also": mode.also, "share": mode.share, "low": -MOST_SD, "high": MOST_SD}
            for mode in shape_table().modes
        ],
        "tables": {name: list(grade_table(name).grades) for name in grade_tables()},
        "protocols": {name: protocol_table(one) for name, one in protocols.items() if not one.apart_mm},
        "presets": {
            name: {"knee": _started(preset.knee, optional, f"preset {name}"), "protocol": preset.protocol}
            for name, preset in table.preset.items()
        },
        "default": {"knee": _started({}, optional, "default"), "protocol": "reference"},
        "largest_seed": LARGEST_EXACT,
    }


def page_knee(knee: Knee) -> dict[str, Any]:
    """Field name -> value as a browser can hold it: its seeds as text."""
    return {**knee_table(knee), **{name: str(getattr(knee, name)) for name in ("form_seed", "texture_seed")}}


def _started(given: dict[str, Any], optional: set[str], what: str) -> dict[str, Any]:
    """A knee to start from; what is resolved at its birth is left open, so that it goes on following BMI and sex."""
    return page_knee(knee_from(given, what)) | dict.fromkeys(optional - set(given))


def _group(group: Group, laws: Mapping[str, FieldLaw], table: Explored) -> dict[str, Any]:
    return {"title": group.title, "fields": [_field(name, laws[name], table) for name in group.fields]}


def _fields(of: type[Any], laws: Mapping[str, FieldLaw], table: Explored) -> list[dict[str, Any]]:
    defaults = {one.name: one.default for one in fields(of)}
    listed = [_field(name, law, table) for name, law in laws.items()]
    return [{**one, "start": _start(one, defaults[one["name"]])} for one in listed]


def _start(one: dict[str, Any], default: Any) -> Any:
    """Value of a new one: its default, or the first word or a small size where there is none."""
    if isinstance(default, int | float | str):
        return default
    return one["choices"][0] if one["choices"] else max(2.0, one["low"])


def _field(name: str, law: FieldLaw, table: Explored) -> dict[str, Any]:
    bounds = law.range or law.whole
    low, high = bounds or (None, None)
    shown = table.slider.get(name, bounds) or (None, None)
    return {
        "name": name,
        "what": law.what,
        "unit": law.unit,
        "allowed": law.allowed,
        "source": law.source,
        "low": low,
        "high": min(high, MOST_PIXELS) if name in ("rows", "cols") and high is not None else high,
        "slider": list(shown),
        "whole": law.whole is not None,
        "text": law.whole is not None and law.whole[1] > LARGEST_EXACT,
        "named": law.pattern is not None,
        "choices": None if law.choices is None else list(law.choices),
        "optional": law.optional,
    }
