"""Load the layouts of the measured tables (``docs/validation/tables.toml``), and format measured rows as cells."""

import csv
import json
import string
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import Any

Row = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Layout of a measured table, or of a picture that shows measured values.

    Attributes
    ----------
    name : str
        Name of the table or picture.
    command : str
        Command that measures the table or picture.
    measured_by : tuple of str
        Modules that measure the table or picture. The code digest covers these modules and all modules that they
        import.
    file : str
        File in the output folder of the command.
    kind : {"table", "picture"}
        Whether the entry is a table or a picture.
    alt : str
        Description of a picture.
    derive : str
        ``module:function`` that computes the rows from the DataFrame of a CSV file; empty if the rows of the file are
        used without change.
    columns : dict of str to str
        Format of the cells of each column, as in `str.format`, keyed by heading. ``{name!p}`` shows underscores as
        spaces.
    row_filters : tuple of dict
        Filters, each of which lists the allowed values by column. A row is shown if it passes at least one filter.
    group_by : tuple of str or None
        Columns by which rows are grouped. Each group becomes one row with the additional columns ``count`` and, for
        every other numeric column, ``least_NAME``, ``most_NAME`` and ``total_NAME``. An empty tuple merges all rows;
        None merges none.
    value_labels : dict of str to dict of str to str
        Text that is shown instead of a value, keyed by column and then by value.
    pivot_format : str
        Format of the heading of the pivot column that shows the value of a row; empty if the table has no pivot
        columns.
    headings : tuple of str
        Headings of the pivot columns, from left to right.
    cell_format : str
        Format of the cells in the pivot columns.
    """

    name: str
    command: str
    measured_by: tuple[str, ...]
    file: str
    kind: str = "table"
    alt: str = ""
    derive: str = ""
    columns: dict[str, str] = field(default_factory=dict)
    row_filters: tuple[dict[str, Any], ...] = ()
    group_by: tuple[str, ...] | None = None
    value_labels: dict[str, dict[str, str]] = field(default_factory=dict)
    pivot_format: str = ""
    headings: tuple[str, ...] = ()
    cell_format: str = ""

    def list_headings(self) -> list[str]:
        """List the headings of the table.

        Returns
        -------
        list of str
            Headings, from left to right.
        """
        return [*self.columns, *self.headings]

    def format_cells(self, rows: Sequence[Row]) -> list[list[str]]:
        """Format the cells of the table.

        In a layout with pivot columns, rows with equal cells in all other columns share one line.

        Parameters
        ----------
        rows : sequence of dict
            Measured rows, by column name.

        Returns
        -------
        list of list of str
            Formatted cells of each line of the table.

        Raises
        ------
        ValueError
            If the rows lack a column that the layout shows.
        """
        try:
            return self._format_lines(rows)
        except KeyError as error:
            columns = ", ".join(rows[0]) if rows else "none"
            raise ValueError(f"columns of {self.file} must include {error}, got {columns}") from None

    def _format_lines(self, rows: Sequence[Row]) -> list[list[str]]:
        """Format the cells of each line; a missing column raises KeyError."""
        cells = _CellFormatter()
        lines: dict[tuple[str, ...], dict[str, str]] = {}
        for number, row in enumerate(self._group([row for row in rows if self._is_selected(row)])):
            values = {name: self.value_labels.get(name, {}).get(str(value), value) for name, value in row.items()}
            first = tuple(cells.vformat(text, (), values).strip() for text in self.columns.values())
            line = lines.setdefault(first if self.pivot_format else (*first, str(number)), {})
            if self.pivot_format:
                line[cells.vformat(self.pivot_format, (), values)] = cells.vformat(self.cell_format, (), values)
        return [
            [*first[: len(self.columns)], *(line.get(heading, "") for heading in self.headings)]
            for first, line in lines.items()
        ]

    def _is_selected(self, row: Row) -> bool:
        """Return whether a row passes at least one filter; True if there are no filters."""
        return not self.row_filters or any(
            all(row[name] in values for name, values in one.items()) for one in self.row_filters
        )

    def _group(self, rows: Sequence[Row]) -> list[dict[str, Any]]:
        """Return the rows, or one summary row per group if the layout groups them."""
        if self.group_by is None:
            return [dict(row) for row in rows]
        groups: dict[tuple[Any, ...], list[Row]] = {}
        for row in rows:
            groups.setdefault(tuple(row[name] for name in self.group_by), []).append(row)
        return [_summarise(group, self.group_by) for group in groups.values()]


def load_layouts(path: Path) -> dict[str, Layout]:
    """Load the layouts of all tables and pictures.

    An entry with the key ``like`` inherits missing keys from the table that ``like`` names.

    Parameters
    ----------
    path : Path
        The file ``tables.toml``.

    Returns
    -------
    dict of str to Layout
        Layout of each table or picture, keyed by name.

    Raises
    ------
    ValueError
        If an entry has an unknown key or lacks a required key.
    """
    given = tomllib.loads(path.read_text(encoding="utf-8"))
    layouts = {}
    for kind in ("table", "picture"):
        for name, entries in given[kind].items():
            entries = given["table"][entries["like"]] | entries if "like" in entries else entries
            known = {"kind": kind, "name": name, "file": f"{name}.csv"}
            known |= {key: _freeze(value) for key, value in entries.items() if key != "like"}
            unknown = known.keys() - {one.name for one in fields(Layout)}
            missing = {"command", "measured_by"} - known.keys()
            if unknown or missing:
                raise ValueError(f"{kind} {name} must have command and measured_by, got {', '.join(known)}")
            layouts[name] = Layout(**known)
    return layouts


def read_rows(layout: Layout, folder: Path, renamed: Mapping[str, str]) -> list[dict[str, Any]]:
    """Read the rows of a table from the output folder of its command.

    Parameters
    ----------
    layout : Layout
        Layout of the table.
    folder : Path
        Output folder.
    renamed : mapping of str to str
        Current name of each renamed column, keyed by its earlier name.

    Returns
    -------
    list of dict
        Rows, each keyed by column name. Numeric texts are converted to numbers.

    Raises
    ------
    ValueError
        If the file lacks a column that ``derive`` needs.
    """
    path = folder / layout.file.partition("#")[0]
    if path.suffix == ".json":
        listed = json.loads(path.read_text(encoding="utf-8"))[layout.file.partition("#")[2]]
        return [{renamed.get(name, name): value for name, value in row.items()} for row in listed]
    if layout.derive:
        import pandas as pd

        module, _, function = layout.derive.partition(":")
        table = pd.read_csv(path).rename(columns=renamed)
        try:
            rows: list[dict[str, Any]] = getattr(import_module(module), function)(table).to_dict("records")
        except KeyError as error:
            raise ValueError(f"columns of {layout.file} must include {error}, got {', '.join(table)}") from None
        return rows
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {renamed.get(name, name): _parse_number(text) for name, text in row.items()} for row in csv.DictReader(file)
        ]


class _CellFormatter(string.Formatter):
    """Extend `str.format` for table cells: format missing values as an empty text."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Format a value; return an empty text for None, "" and NaN."""
        # NaN is the only value that differs from itself.
        return "" if value is None or value == "" or value != value else format(value, format_spec)

    def convert_field(self, value: Any, conversion: Any) -> Any:
        """Convert a value; `!p` replaces underscores by spaces."""
        return str(value).replace("_", " ") if conversion == "p" else super().convert_field(value, conversion)


def _summarise(group: Sequence[Row], by: Sequence[str]) -> dict[str, Any]:
    """Summarise a group by its first row, its row count, and the minimum, maximum and sum of each numeric column."""
    summary: dict[str, Any] = {**group[0], "count": len(group)}
    for name in group[0]:
        numbers = [row[name] for row in group if isinstance(row[name], int | float)]
        if numbers and name not in by:
            summary |= {f"least_{name}": min(numbers), f"most_{name}": max(numbers), f"total_{name}": sum(numbers)}
    return summary


def _parse_number(text: str) -> Any:
    """Convert a text to int or float if it is a number."""
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def _freeze(value: Any) -> Any:
    """Convert a list to a tuple."""
    return tuple(value) if isinstance(value, list) else value
