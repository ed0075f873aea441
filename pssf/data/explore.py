"""What the page of `pssf explore` shows, as `data/explore.toml` has it, and the files that the page is made of."""

from functools import cache
from pathlib import Path
from typing import Any

from msgspec import field

from .records import Pair, Record, record
from .tables import data

_PAGE = Path(__file__).resolve().parents[1] / "explore" / "page"
# Types that a browser takes for what they are.
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}


class Group(Record, frozen=True):
    """Fields under one heading."""

    title: str
    fields: tuple[str, ...]


class Preset(Record, frozen=True):
    """A state by name: a protocol, and fields of a knee that differ from its defaults."""

    protocol: str
    knee: dict[str, Any] = field(default_factory=dict)


class Explored(Record, frozen=True):
    """All of `data/explore.toml`.

    left_out  "knee" and "protocol" -> fields that are in no group
    slider    field -> how far its slider reaches, where that is less than the field's range
    """

    knee: tuple[Group, ...]
    protocol: tuple[Group, ...]
    left_out: dict[str, tuple[str, ...]]
    slider: dict[str, Pair]
    preset: dict[str, Preset]


@cache
def explored() -> Explored:
    """The table."""
    return record(Explored, data("explore"), "explore")


@cache
def page_files() -> dict[str, tuple[str, bytes]]:
    """Name of a file of the page -> its type and its bytes."""
    return {path.name: (TYPES[path.suffix], path.read_bytes()) for path in sorted(_PAGE.iterdir())}
