"""One HTML page with all that was measured; nothing in it is fetched from anywhere."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jinja2

from ..study.report.page import Picture

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of one table: `name` of its file, what its columns are."""

    name: str
    rows: Sequence[Row]
    caption: str
    shown: int = 60

    @property
    def columns(self) -> list[str]:
        """In the order in which they first occur."""
        return list(dict.fromkeys(name for row in self.rows for name in row))


@dataclass(frozen=True, kw_only=True)
class Section:
    """One part of the meter.

    name     of the part
    line     what it found, in one line
    text     what is measured, and what an interval holds
    tables   with their rows
    figures  under the tables
    facts    for machines
    """

    name: str
    line: str
    text: str
    tables: tuple[Table, ...] = ()
    figures: tuple[Picture, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)


def render(sections: Sequence[Section], facts: dict[str, Any]) -> str:
    """The page.

    facts  what it was measured from, by name
    """
    environment = jinja2.Environment(loader=jinja2.PackageLoader(__package__, "."), autoescape=True, trim_blocks=True)
    environment.filters["cell"] = _cell
    return environment.get_template("realism.html.j2").render(sections=sections, facts=facts)


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
