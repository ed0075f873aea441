"""Field definitions for knees, osteophytes, cysts, protocols and detectors (``data/*_fields.toml``)."""

import re
from functools import cache
from typing import Any

from ...core.checks import (
    InputError,
    require_choice,
    require_in_range,
    require_integer,
)
from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record

# Largest allowed seed, which is the largest signed 64-bit integer.
_MAX_INT64 = 2**63 - 1


class FieldSpec(Record, frozen=True):
    """Definition of one field: meaning, unit and allowed values.

    Attributes
    ----------
    label : str
        Short label on the ``pssf explore`` page, without the unit.
    description : str
        Meaning of the field.
    unit : str
        Unit of the value; empty for a value without a unit.
    range : (float, float) or None
        Lower and upper bound of a float field; None for other fields.
    integer_range : (int, int) or None
        Lower and upper bound of an integer field; None for other fields.
    choices : tuple or None
        Allowed values, as strings or integers; None if the field has no list of values. If `form` is also specified,
        only text must be among these values.
    pattern : str or None
        Description of the characters that are allowed in a name; None if the field is not a name.
    max_length : int or None
        Maximum length of a text field, in characters; None for other fields.
    form : str or None
        Description of the allowed values of a field with structured values, which its dataclass checks.
    value_type : str
        Type of a structured value, for the documentation.
    optional : bool
        Whether None is an allowed value.
    source : str
        Literature source of typical values.
    """

    label: str
    description: str
    unit: str = ""
    range: Pair | None = None
    integer_range: tuple[int, int] | None = None
    choices: tuple[str | int, ...] | None = None
    pattern: str | None = None
    max_length: int | None = None
    form: str | None = None
    value_type: str = ""
    optional: bool = False
    source: str = ""

    def check(self, name: str, value: Any) -> None:
        """Check that a value is allowed for the field.

        Parameters
        ----------
        name : str
            Name of the field, shown in error messages.
        value : Any
            Value to check.

        Raises
        ------
        InputError
            If the value is not allowed. The message contains the field name, the allowed values and the invalid value.
        """
        if self.optional and value is None:
            return
        if self.pattern is not None and not (isinstance(value, str) and re.fullmatch(r"[\w-]{1,64}", value)):
            raise InputError(f"{name} must be {self.pattern}, got {value!r}")
        if self.max_length is not None and not (isinstance(value, str) and 1 <= len(value) <= self.max_length):
            raise InputError(f"{name} must be {self.allowed_text}, got {value!r}")
        if self.range is not None:
            require_in_range(name, value, *self.range, self.unit)
        if self.integer_range is not None:
            require_integer(name, value, *self.integer_range, self.unit)
        if self.choices is not None and (self.form is None or isinstance(value, str)):
            require_choice(name, value, (*self.choices, None) if self.optional else self.choices)

    @property
    def number_type(self) -> type[float] | type[int] | None:
        """Numerical type of the field, float or int; None for a field that is not numerical."""
        return float if self.range else int if self.integer_range else None

    @property
    def allowed_text(self) -> str:
        """Description of the allowed values, for error messages and field lists."""
        bounds = self.range or self.integer_range
        if bounds:
            return f"{bounds[0]:g} to {'2**63 - 1' if bounds[1] == _MAX_INT64 else format(bounds[1], 'g')}"
        if self.max_length:
            return f"text of 1 to {self.max_length} characters"
        words = ", ".join(map(str, self.choices or ()))
        return self.pattern or (f"{words}, or {self.form}" if words and self.form else words or self.form or "")


def check_fields(kind: str, values: Any) -> None:
    """Check all fields of a parameter dataclass and convert numbers to Python's float and int.

    The numbers are converted in place, even in a frozen dataclass, because compiled code accepts no other numerical
    types.

    Parameters
    ----------
    kind : {"knee", "osteophyte", "cyst", "protocol", "detector"}
        Kind of object, which selects the table ``data/<kind>_fields.toml`` of field definitions.
    values : dataclass instance
        Object to check.

    Raises
    ------
    InputError
        If a value is not allowed. The message contains the field name, the allowed values and the invalid value.
    """
    for name, law in load_field_specs(kind).items():
        value = getattr(values, name)
        law.check(name, value)
        if value is not None and law.number_type is not None:
            object.__setattr__(values, name, law.number_type(value))


def beam_angle_range_deg() -> Pair:
    """Return the allowed range of the beam angle in a protocol.

    Returns
    -------
    (float, float)
        Lowest and highest angle, in degrees.
    """
    bounds = load_field_specs("protocol")["beam_angle_deg"].range
    assert bounds is not None
    return bounds


@cache
def load_field_specs(kind: str) -> dict[str, FieldSpec]:
    """Load the definitions of all fields of a knee, an osteophyte, a cyst, a protocol or a detector.

    Parameters
    ----------
    kind : {"knee", "osteophyte", "cyst", "protocol", "detector"}
        Kind of object, which selects the table ``data/<kind>_fields.toml``.

    Returns
    -------
    dict of str to FieldSpec
        Definitions, keyed by field name.
    """
    name = f"{kind}_fields"
    return parse_record(dict[str, FieldSpec], load_data_table(name), name)
