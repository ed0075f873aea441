"""Define the base class and the parser of table records; the parser checks names and types."""

from threading import RLock
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")
Numbers = tuple[float, ...]
Rows = tuple[Numbers, ...]
Triple = tuple[float, float, float]
Pair = tuple[float, float]


# Lock around msgspec, because version 0.22 crashes if two threads use a new type at the same time. The lock is
# reentrant, because constructing a record may convert other records.
MSGSPEC_LOCK = RLock()


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of all table records: frozen, hashable, and strict about unknown entries.

    Records are hashable, so that functions with record arguments can be cached.
    """


def parse_record(record_type: type[T], table: Any, label: str) -> T:
    """Convert a mapping that was read from TOML to a record or another typed value.

    Parameters
    ----------
    record_type : type
        Target type, such as a `Record` or ``dict[str, Record]``.
    table : Any
        Content of the table.
    label : str
        Name of the table, shown in error messages.

    Returns
    -------
    record_type
        Converted value.

    Raises
    ------
    ValueError
        If an entry is missing, unknown or of the wrong type. The message names the table and the entry.
    """
    try:
        with MSGSPEC_LOCK:
            return msgspec.convert(table, record_type)
    except msgspec.ValidationError as error:
        raise ValueError(
            f"table {label} must have the form of "
            f"{record_type.__name__ if isinstance(record_type, type) else record_type}, got: {error}"
        ) from None


def encode_records(*values: Any) -> bytes:
    """Encode records as JSON bytes, for example as part of a cache key.

    Parameters
    ----------
    *values : Any
        Records, or tuples of records.

    Returns
    -------
    bytes
        Encoded values.
    """
    return msgspec.json.encode(values)
