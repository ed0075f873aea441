"""List of the fields, grade tables, protocols and presets that the explore page shows."""

from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Any

from ..data.anatomy.shape_table import load_shape_model
from ..data.data_files import list_protocols
from ..data.imaging.explore_table import FieldGroup, PageSettings, load_page_settings
from ..data.knees.field_definitions import FieldSpec, load_field_specs
from ..data.knees.grade_tables import list_grade_tables, load_grade_table
from ..model.knee import (
    MAX_CYSTS,
    MAX_SHAPE_SD,
    Cyst,
    Knee,
    Osteophyte,
    knee_from_dict,
    knee_to_dict,
)
from ..model.protocol import load_protocol, protocol_to_dict

# Largest integer that JavaScript represents exactly. Larger integers are sent as strings.
MAX_EXACT_INTEGER = 2**53 - 1
# Maximum number of rows or columns of an image on the explore page. Cached data of a larger image would need several
# gigabytes.
MAX_SIDE_PX = 4096
_ITEMS: dict[str, type[Any]] = {"osteophyte": Osteophyte, "cyst": Cyst}


@cache
def build_listing() -> dict[str, Any]:
    """Build the listing of all fields, tables and protocols that the explore page shows.

    Returns
    -------
    dict
        JSON-ready listing. It contains groups of fields with label, unit, range and description, as well as grade
        tables, protocols, display processing methods, presets and defaults.
    """
    table, laws = load_page_settings(), {kind: load_field_specs(kind) for kind in ("knee", "protocol", *_ITEMS)}
    optional = {name for name, law in laws["knee"].items() if law.optional}
    protocols = {name: load_protocol(name) for name in list_protocols()}
    return {
        "knee": [_describe_group(group, laws["knee"], table) for group in table.knee],
        "protocol": [_describe_group(group, laws["protocol"], table) for group in table.protocol],
        "items": {f"{kind}s": _describe_fields(of, laws[kind], table) for kind, of in _ITEMS.items()},
        "most": {"osteophytes": 12, "cysts": MAX_CYSTS},
        "shape": [
            {"name": mode.name, "also": mode.also, "low": -MAX_SHAPE_SD, "high": MAX_SHAPE_SD}
            for mode in load_shape_model().modes
        ],
        "tables": {name: list(load_grade_table(name).grades) for name in list_grade_tables()},
        "protocols": {name: protocol_to_dict(one) for name, one in protocols.items() if not one.knee_distance_mm},
        "presets": {
            name: {"knee": _make_start_knee(preset.knee, optional, f"preset {name}"), "protocol": preset.protocol}
            for name, preset in table.preset.items()
        },
        "processing": dict(table.processing),
        "default": {
            "knee": _make_start_knee({}, optional, "default"),
            "protocol": "reference",
            "processing": next(iter(table.processing)),
        },
        "largest_seed": MAX_EXACT_INTEGER,
    }


def knee_to_page_dict(knee: Knee) -> dict[str, Any]:
    """Convert a knee to a dict of values that JavaScript represents exactly.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.

    Returns
    -------
    dict
        Values, keyed by field name. Seeds are strings, because JavaScript rounds large integers.
    """
    return {**knee_to_dict(knee), **{name: str(getattr(knee, name)) for name in ("form_seed", "texture_seed")}}


def _make_start_knee(given: dict[str, Any], optional: set[str], source_name: str) -> dict[str, Any]:
    """Make the field values of an initial knee.

    Optional fields without a given value are None, so that BMI and sex determine the values.
    """
    return knee_to_page_dict(knee_from_dict(given, source_name)) | dict.fromkeys(optional - set(given))


def _describe_group(group: FieldGroup, laws: Mapping[str, FieldSpec], table: PageSettings) -> dict[str, Any]:
    """Return the title of a field group and the descriptions of its fields."""
    return {"title": group.title, "fields": [_describe_field(name, laws[name], table) for name in group.fields]}


def _describe_fields(item_type: type[Any], laws: Mapping[str, FieldSpec], table: PageSettings) -> list[dict[str, Any]]:
    """Return the field descriptions of an osteophyte or a cyst, with initial values for a new item."""
    defaults = {one.name: one.default for one in fields(item_type)}
    listed = [_describe_field(name, law, table) for name, law in laws.items()]
    return [{**one, "start": _start_value(one, defaults[one["name"]])} for one in listed]


def _start_value(field: dict[str, Any], default: Any) -> Any:
    """Return the initial value of a field: its default, or else its first choice, or else a small size."""
    if isinstance(default, int | float | str):
        return default
    return field["choices"][0] if field["choices"] else max(2.0, field["low"])


def _describe_field(name: str, law: FieldSpec, table: PageSettings) -> dict[str, Any]:
    """Return name, label, unit, range, source and control type of a field."""
    bounds = law.range or law.integer_range
    low, high = bounds or (None, None)
    shown = table.slider.get(name, bounds) or (None, None)
    return {
        "name": name,
        "label": law.label,
        "what": law.description,
        "unit": law.unit,
        "allowed": law.allowed_text,
        "source": law.source,
        "low": low,
        "high": min(high, MAX_SIDE_PX) if name in ("rows", "cols") and high is not None else high,
        "slider": list(shown),
        "whole": law.integer_range is not None,
        "text": law.integer_range is not None and law.integer_range[1] > MAX_EXACT_INTEGER,
        "named": law.pattern is not None,
        "choices": None if law.choices is None else list(law.choices),
        "optional": law.optional,
    }
