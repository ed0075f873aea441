"""Content of the page of ``pssf explore``: its fields (``data/explore.toml``) and its files."""

from functools import cache
from pathlib import Path
from typing import Any

from msgspec import field

from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record

_PAGE_FOLDER = Path(__file__).resolve().parents[2] / "explore" / "page"
# File suffix -> content type in the HTTP header.
CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}


class FieldGroup(Record, frozen=True):
    """Fields of the page under one heading.

    Attributes
    ----------
    title : str
        Heading.
    fields : tuple of str
        Names of fields, in order.
    """

    title: str
    fields: tuple[str, ...]


class PagePreset(Record, frozen=True):
    """Starting state of the page.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    knee : dict of str to Any
        Fields of the knee that differ from their defaults.
    """

    protocol: str
    knee: dict[str, Any] = field(default_factory=dict)


class PageSettings(Record, frozen=True):
    """Settings of the page.

    Attributes
    ----------
    knee : tuple of FieldGroup
        Groups of knee fields.
    protocol : tuple of FieldGroup
        Groups of protocol fields.
    hidden_fields : dict of str to tuple of str
        "knee" and "protocol" -> fields that are in no group.
    slider : dict of str to (float, float)
        Field -> range of its slider, if it is narrower than the range of the field; in the unit of the field.
    preset : dict of str to PagePreset
        Name -> starting state.
    """

    knee: tuple[FieldGroup, ...]
    protocol: tuple[FieldGroup, ...]
    hidden_fields: dict[str, tuple[str, ...]]
    slider: dict[str, Pair]
    preset: dict[str, PagePreset]


@cache
def load_page_settings() -> PageSettings:
    """Load the settings of the page.

    Returns
    -------
    PageSettings
        Content of ``data/explore.toml``.
    """
    return parse_record(PageSettings, load_data_table("explore"), "explore")


@cache
def load_page_files() -> dict[str, tuple[str, bytes]]:
    """Load the files that the page consists of.

    Returns
    -------
    dict of str to (str, bytes)
        File name -> content type and content.
    """
    return {path.name: (CONTENT_TYPES[path.suffix], path.read_bytes()) for path in sorted(_PAGE_FOLDER.iterdir())}
