"""FieldLaw: what a field of a knee or of a protocol is and may be, as `data/*_fields.toml` have it."""

from functools import cache

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
    optional  whether None is allowed
    source    of usual values
    """

    what: str
    unit: str = ""
    range: Pair | None = None
    whole: tuple[int, int] | None = None
    choices: tuple[str | int, ...] | None = None
    pattern: str | None = None
    optional: bool = False
    source: str = ""

    @property
    def allowed(self) -> str:
        """What it may be, in words."""
        bounds = self.range or self.whole
        if bounds:
            return f"{bounds[0]:g} to {bounds[1]:g}"
        return self.pattern or ", ".join(map(str, self.choices or ()))


@cache
def field_laws(kind: str) -> dict[str, FieldLaw]:
    """Field -> what it is and may be; kind "protocol" or "knee"."""
    name = f"{kind}_fields"
    return record(dict[str, FieldLaw], data(name), name)
