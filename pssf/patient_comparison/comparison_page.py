"""Render the patient comparison as a self-contained HTML page."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jinja2

from ..study.report.report_elements import Picture

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Table:
    """One table of the comparison page.

    Parameters
    ----------
    name : str
        Name of the CSV file without extension.
    rows : sequence of dict
        Rows of the table.
    caption : str
        Caption that explains the columns.
    max_rows_shown : int, default 60
        Maximum number of displayed rows; 0 hides the table.
    """

    name: str
    rows: Sequence[Row]
    caption: str
    max_rows_shown: int = 60

    @property
    def columns(self) -> list[str]:
        """Column names in order of first occurrence in the rows."""
        return list(dict.fromkeys(name for row in self.rows for name in row))


@dataclass(frozen=True, kw_only=True)
class Section:
    """One section of the comparison page.

    Parameters
    ----------
    name : str
        Heading of the section.
    summary : str
        Main result in one line.
    text : str
        Text that explains the measurements and confidence intervals.
    tables : tuple of Table
        Tables of the section.
    figures : tuple of Picture
        Figures, displayed below the tables.
    facts : dict
        Results for the JSON file, keyed by name.
    """

    name: str
    summary: str
    text: str
    tables: tuple[Table, ...] = ()
    figures: tuple[Picture, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)


def render_page(sections: Sequence[Section], facts: dict[str, Any]) -> str:
    """Render the comparison page as HTML.

    Parameters
    ----------
    sections : sequence of Section
        Sections of the page.
    facts : dict
        Settings of the comparison, keyed by name.

    Returns
    -------
    str
        Complete HTML page.
    """
    environment = jinja2.Environment(loader=jinja2.PackageLoader(__package__, "."), autoescape=True, trim_blocks=True)
    environment.filters["cell"] = _format_cell
    return environment.get_template("patient_comparison.html.j2").render(sections=sections, facts=facts)


def _format_cell(value: Any) -> str:
    """Format a table cell; missing values become an empty string."""
    if value is None or value != value:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
