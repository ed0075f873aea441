"""Measured tables of the READMEs, as `data/readme.toml` has them."""

from functools import cache
from typing import Any

from msgspec import field

from .records import Record, record
from .tables import data


class Layout(Record, frozen=True):
    """How a table is shown.

    command   that measures it; a name in braces is an option of the run
    columns   heading -> format of a row, as for `str.format`; `{name!p}` shows underscores as blanks
    rows      name of what is measured, as the command's CSV file is called; the table's own if empty
    only      alternatives, each column -> values: a row that fits none of them is not shown
    by        columns: rows that agree in them are shown as one, which also has count, and least_, most_ and total_ of
              every other column that holds numbers; with no column, all are one
    words     column -> value -> what is shown instead, both as text
    across    format whose values head further columns, of which `headings` are shown, in that order
    cell      format of what stands in those
    """

    command: str
    columns: dict[str, str]
    rows: str = ""
    only: tuple[dict[str, tuple[Any, ...]], ...] = ()
    by: tuple[str, ...] | None = None
    words: dict[str, dict[str, str]] = field(default_factory=dict)
    across: str = ""
    headings: tuple[str, ...] = ()
    cell: str = ""


class Readmes(Record, frozen=True):
    """The READMEs of a source checkout and what of them is measured.

    files    paths from the checkout
    picture  name -> where one stands that is drawn from measured values
    table    name -> layout
    """

    files: tuple[str, ...]
    picture: dict[str, str]
    table: dict[str, Layout]

    def shown(self, measured: str) -> list[str]:
        """Names of the tables that show what is measured under a name."""
        return [name for name, layout in self.table.items() if (layout.rows or name) == measured]


@cache
def readmes() -> Readmes:
    """All of the READMEs' tables; what a layout does not say is as of the one that it is `like`."""
    given = data("readme")
    layouts = given["table"]
    for name, layout in layouts.items():
        if "like" in layout:
            layouts[name] = layouts[layout.pop("like")] | layout
    return record(Readmes, given, "readme")
