"""FieldLaw: what a field of a knee or of a protocol is and may be, as `data/*_fields.toml` have it."""

import re
from functools import cache
from typing import Any

from ..core.checks import InputError, require, require_choice, require_whole
from .records import Pair, Record, record
from .tables import data


class FieldLaw(Record, frozen=True):
    """One field.

    what      it is, in a few words
    unit      of its value
    range     bounds of a number
    whole     bounds of a whole number
    choices   words
    pattern   of a name, in words
    text      most characters of a text
    optional  whether None is allowed
    source    of usual values
    """

    what: str
    unit: str = ""
    range: Pair | None = None
    whole: tuple[int, int] | None = None
    choices: tuple[str | int, ...] | None = None
    pattern: str | None = None
    text: int | None = None
    optional: bool = False
    source: str = ""

    def check(self, name: str, value: Any) -> None:
        """Refuse what a field may not be.

        raises  InputError naming the field, its value and what is allowed
        """
        if self.optional and value is None:
            return
        if self.pattern is not None and not (isinstance(value, str) and re.fullmatch(r"[\w-]{1,64}", value)):
            raise InputError(f"{name} = {value!r}; allowed: {self.pattern}")
        if self.text is not None and not (isinstance(value, str) and 1 <= len(value) <= self.text):
            raise InputError(f"{name} must be {self.allowed}, got {value!r}")
        if self.range is not None:
            require(name, value, *self.range, self.unit)
        if self.whole is not None:
            require_whole(name, value, *self.whole, self.unit)
        if self.choices is not None:
            require_choice(name, value, (*self.choices, None) if self.optional else self.choices)

    @property
    def number(self) -> type[float] | type[int] | None:
        """Kind of number that it is, or None."""
        return float if self.range else int if self.whole else None

    @property
    def allowed(self) -> str:
        """What it may be, in words."""
        bounds = self.range or self.whole
        if bounds:
            return f"{bounds[0]:g} to {bounds[1]:g}"
        if self.text:
            return f"text of 1 to {self.text} characters"
        return self.pattern or ", ".join(map(str, self.choices or ()))


def check_fields(kind: str, values: Any) -> None:
    """Refuse a field of a parameter dataclass that is not what `data/<kind>_fields.toml` allows.

    Numbers become Python's, of the kind that the law has: what is written in C takes no others.
    raises  InputError naming the field, its value and what is allowed
    """
    for name, law in field_laws(kind).items():
        value = getattr(values, name)
        law.check(name, value)
        if value is not None and law.number is not None:
            object.__setattr__(values, name, law.number(value))


def beam_range_deg() -> Pair:
    """That the central ray of a protocol may be tilted by."""
    bounds = field_laws("protocol")["beam_angle_deg"].range
    assert bounds is not None
    return bounds


@cache
def field_laws(kind: str) -> dict[str, FieldLaw]:
    """Field -> what it is and may be; kind "protocol" or "knee"."""
    name = f"{kind}_fields"
    return record(dict[str, FieldLaw], data(name), name)
