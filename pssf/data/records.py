"""A table of the package as a frozen record: every name and type is checked when it is read, once."""

from threading import RLock
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")
Numbers = tuple[float, ...]
Rows = tuple[Numbers, ...]
Triple = tuple[float, float, float]
Pair = tuple[float, float]


# msgspec describes a type to itself when it first meets it, and a thread that meets it meanwhile crashes (0.22).
# Whoever may be in a thread holds this; twice, where a record makes others.
TYPES_LOCK = RLock()


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a table holds, by name; hashable, so that what is made from it can be kept under it."""


def record(kind: type[T], table: Any, what: str) -> T:
    """A record, or another typed value, from a mapping as TOML gives it.

    what    how the table is called in a refusal
    raises  ValueError naming the table and the entry that is missing, unknown or of another type
    """
    try:
        with TYPES_LOCK:
            return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise ValueError(
            f"table {what}: {error}; allowed: {kind.__name__ if isinstance(kind, type) else kind}"
        ) from None


def encoded(*values: Any) -> bytes:
    """Records, or tuples of them, as bytes that are others where they differ."""
    return msgspec.json.encode(values)
