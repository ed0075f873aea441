"""Content of the web page of ``pssf explore``: settings (``data/explore.toml``) and files."""

from functools import cache
from pathlib import Path
from typing import Any

from msgspec import field

from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record

_PAGE_FOLDER = Path(__file__).resolve().parents[2] / "explore" / "page"
# Content types in the HTTP header, keyed by file suffix.
CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}


class FieldGroup(Record, frozen=True):
    """Group of fields under one heading of the page.

    Attributes
    ----------
    title : str
        Heading of the group on the page.
    fields : tuple of str
        Names of the fields in the order of display.
    """

    title: str
    fields: tuple[str, ...]


class PagePreset(Record, frozen=True):
    """Preset of the page: protocol and knee.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    knee : dict of str to Any
        Values of the knee fields that differ from their defaults.
    """

    protocol: str
    knee: dict[str, Any] = field(default_factory=dict)


class PageSettings(Record, frozen=True):
    """Settings of the page of ``pssf explore``.

    Attributes
    ----------
    knee : tuple of FieldGroup
        Groups of knee fields.
    protocol : tuple of FieldGroup
        Groups of protocol fields.
    hidden_fields : dict of str to tuple of str
        Fields without a group, keyed by "knee" and "protocol".
    slider : dict of str to (float, float)
        Slider ranges that are narrower than the range of the field, in the unit of the field, keyed by field name.
    processing : dict of str to str
        Label of each display processing, keyed by name; the first entry is the default of the page.
    preset : dict of str to PagePreset
        Presets, keyed by name.
    """

    knee: tuple[FieldGroup, ...]
    protocol: tuple[FieldGroup, ...]
    hidden_fields: dict[str, tuple[str, ...]]
    slider: dict[str, Pair]
    processing: dict[str, str]
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
    """Load the files of the web page.

    Returns
    -------
    dict of str to (str, bytes)
        Content type and content of each file, keyed by file name.
    """
    return {path.name: (CONTENT_TYPES[path.suffix], path.read_bytes()) for path in sorted(_PAGE_FOLDER.iterdir())}
