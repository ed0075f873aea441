"""Measured tables in the READMEs of a source checkout: rows replace the text between the markers of a table::

    <!-- table: engines -->
    <!-- /table -->

The columns of a table, and the command that measures its rows, are in `data/readme.toml`. A caption above each table
gives the date, the kind of machine and the command of the measurement, so no part is written by hand.
"""

import os
import platform
import re
import string
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from ..core.checks import InputError, require_choice
from ..core.processes.parallel_map import count_cores
from ..data.analysis.readme_table import ReadmeTables, TableLayout, load_readme_tables
from .atomic_write import write_bytes

Row = Mapping[str, Any]
_TABLE_PATTERN = r"(<!-- table: {} -->\n)((?:(?!<!-- table: ).)*?)(<!-- /table -->)"


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Date, machine and options of a measurement.

    Attributes
    ----------
    day : str
        Date, such as 2026-11-22.
    machine : str
        Kind of machine; see `describe_machine`.
    options : dict of str to object
        Options of the run, for the command in the caption.
    note : str
        Further remark for the caption; empty for none.
    """

    day: str
    machine: str
    options: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""


def describe_machine() -> str:
    """Describe this machine: cores that may be used, processor, operating system and Python version.

    Returns
    -------
    str
        Text for a caption.
    """
    processor = platform.machine().replace("_", "-")
    release = ".".join(platform.python_version_tuple()[:2])
    return f"{count_cores()} cores, {processor}, {platform.system()}, Python {release}"


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """A source checkout whose READMEs hold measured tables.

    Attributes
    ----------
    folder : Path or None
        Folder of the checkout; None if no README is to be updated.
    origin : Origin
        Origin of the rows to be written.
    """

    folder: Path | None
    origin: Origin

    def update_tables(
        self, measured: Mapping[str, Sequence[Row]], pictures: Iterable[Path] = (), measured_with: Path | None = None
    ) -> list[Path]:
        """Write measured rows and figures into the checkout.

        Parameters
        ----------
        measured : dict of str to sequence of dict
            Name of a measurement to its rows, by column name.
        pictures : iterable of Path
            Figures of the measurement. PNGs that a README shows are copied to their place.
        measured_with : Path or None
            File that an earlier run wrote when it measured the rows; its date goes into the caption. None: this run
            measured them.

        Returns
        -------
        list of Path
            Files of the checkout that hold the tables and figures; empty if `folder` is None.

        Raises
        ------
        InputError
            `write_tables` raises an InputError.
        """
        if self.folder is None:
            return []
        origin = self.origin
        if measured_with is not None:
            origin = replace(origin, day=date.fromtimestamp(measured_with.stat().st_mtime).isoformat())
        written = write_tables(self.folder, measured, origin)
        tables = load_readme_tables()
        for picture in pictures:
            place = tables.picture.get(picture.stem) if picture.suffix == ".png" else None
            if place is not None:
                written.append(self.folder / place)
                write_bytes(written[-1], picture.read_bytes())
        return written


def open_checkout(folder: Path | None, table_names: Collection[str], **options: Any) -> Checkout:
    """Open a source checkout before a measurement, which is when the load of the machine by other work is noted.

    Parameters
    ----------
    folder : Path or None
        Folder of the checkout; None if no README is to be updated.
    table_names : collection of str
        Names of the measurements that will be written.
    **options : object
        Options of the run, for the captions.

    Returns
    -------
    Checkout
        Checkout to be updated with the measured rows.

    Raises
    ------
    InputError
        `require_checkout` raises an InputError.
    """
    if folder is not None:
        require_checkout(folder, table_names)
    # Windows has no load average.
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    note = "beside other work" if load > count_cores() / 2 else ""
    day = date.today().isoformat()
    return Checkout(folder=folder, origin=Origin(day=day, machine=describe_machine(), options=options, note=note))


def require_checkout(checkout: Path, table_names: Collection[str]) -> None:
    """Require that the READMEs of a folder have the tables of the given measurements.

    Parameters
    ----------
    checkout : Path
        Folder of the checkout.
    table_names : collection of str
        Names of the measurements.

    Raises
    ------
    InputError
        The folder has none of the READMEs, no table shows a measurement, or a table has no markers.
    """
    tables = load_readme_tables()
    texts = _read_readmes(checkout, tables.files).values()
    for source in table_names:
        known = sorted({layout.rows or name for name, layout in tables.table.items()})
        require_choice("table of the READMEs", source, known)
        for name in tables.tables_showing(source):
            if not any(_compile_table_pattern(name).search(text) for text in texts):
                raise InputError(
                    f"READMEs of {checkout} must have the table {name!r}, got none: add the lines "
                    f"<!-- table: {name} --> and <!-- /table --> to {' or '.join(tables.files)}"
                )


def write_tables(checkout: Path, rows_by_name: Mapping[str, Sequence[Row]], origin: Origin) -> list[Path]:
    """Write measured rows into the READMEs of a source checkout.

    Parameters
    ----------
    checkout : Path
        Folder with README.md, meshes/README.md and so on.
    rows_by_name : dict of str to sequence of dict
        Name of a measurement to its rows, by column name.
    origin : Origin
        Origin of the rows, for the captions.

    Returns
    -------
    list of Path
        READMEs that hold one of the tables.

    Raises
    ------
    InputError
        `require_checkout` raises an InputError, a row lacks a column that is shown, or a README cannot be written.
    """
    require_checkout(checkout, rows_by_name.keys())
    tables = load_readme_tables()
    bodies = {
        name: format_table(name, rows, origin, tables)
        for source, rows in rows_by_name.items()
        for name in tables.tables_showing(source)
    }
    written = []
    for path, before in _read_readmes(checkout, tables.files).items():
        after = before
        for name, body in bodies.items():
            after = _replace_table(after, name, body)
        if any(_compile_table_pattern(name).search(before) for name in bodies):
            written.append(path)
        if after != before:
            write_bytes(path, after.encode())
    return written


def format_table(name: str, rows: Sequence[Row], origin: Origin, tables: ReadmeTables) -> str:
    """Format the caption and the Markdown table of a measurement.

    Parameters
    ----------
    name : str
        Name of the table.
    rows : sequence of dict
        Measured rows, by column name.
    origin : Origin
        Origin of the rows, for the caption.
    tables : ReadmeTables
        Layouts of all tables.

    Returns
    -------
    str
        Markdown that ends with an empty line.

    Raises
    ------
    InputError
        A row lacks a column that is shown.
    """
    layout = tables.table[name]
    command = layout.command.format_map(dict(origin.options))
    try:
        lines = _format_lines(layout, rows)
    except KeyError as error:
        raise InputError(f"table {name}: columns must be among {', '.join(rows[0])}, got {error}") from None
    headings = table_headings(layout)
    parts = [headings, ["---"] * len(headings), *lines]
    text = "\n".join(f"| {' | '.join(cell.strip().replace('|', chr(92) + '|') for cell in line)} |" for line in parts)
    caption = ", ".join(part for part in (origin.day, origin.machine, f"`uv run {command}`", origin.note) if part)
    return f"*{caption}*\n\n{text}\n\n"


def table_headings(layout: TableLayout) -> list[str]:
    """Return the headings of a table.

    Parameters
    ----------
    layout : TableLayout
        Layout of the table.

    Returns
    -------
    list of str
        Headings in their order.
    """
    return [*layout.columns, *layout.headings]


class _CellFormatter(string.Formatter):
    """`str.format` for cells: missing values are empty, and text becomes a number for a numeric format."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Format a value; return an empty text for None, "" and NaN."""
        # NaN is the value that differs from itself.
        if value is None or value == "" or value != value:
            return ""
        if isinstance(value, str) and format_spec[-1:] in tuple("eEfFgG%"):
            value = float(value)
        return format(value, format_spec)

    def convert_field(self, value: Any, conversion: Any) -> Any:
        """Convert a value; `!p` replaces underscores by spaces."""
        return str(value).replace("_", " ") if conversion == "p" else super().convert_field(value, conversion)


def _format_lines(layout: TableLayout, rows: Sequence[Row]) -> list[list[str]]:
    """Format the cells of each line.

    In a layout with pivot columns, rows with the same first columns share a line.
    """
    cells = _CellFormatter()
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for number, row in enumerate(_group_rows(layout, [row for row in rows if _is_selected(row, layout.row_filters)])):
        values = {name: layout.value_labels.get(name, {}).get(str(value), value) for name, value in row.items()}
        first = tuple(cells.vformat(text, (), values) for text in layout.columns.values())
        line = lines.setdefault(first if layout.pivot_format else (*first, str(number)), {})
        if layout.pivot_format:
            line[cells.vformat(layout.pivot_format, (), values)] = cells.vformat(layout.cell_format, (), values)
    return [
        [*first[: len(layout.columns)], *(line.get(heading, "") for heading in layout.headings)]
        for first, line in lines.items()
    ]


def _is_selected(row: Row, only: Sequence[Mapping[str, Sequence[Any]]]) -> bool:
    """Return whether a row meets one of the filters (column to allowed values); True if there are no filters."""
    return not only or any(all(row[name] in values for name, values in one.items()) for one in only)


def _group_rows(layout: TableLayout, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rows, or one summary row per group if the layout groups them."""
    if layout.group_by is None:
        return [dict(row) for row in rows]
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in layout.group_by), []).append(row)
    return [_summarise_group(group, layout.group_by) for group in groups.values()]


def _summarise_group(group: Sequence[Row], by: Sequence[str]) -> dict[str, Any]:
    """Summarise a group as its first row, the count, and the minimum, maximum and sum of each numeric column."""
    summary: dict[str, Any] = {**group[0], "count": len(group)}
    for name in group[0]:
        numbers = [row[name] for row in group if isinstance(row[name], int | float)]
        if numbers and name not in by:
            summary |= {f"least_{name}": min(numbers), f"most_{name}": max(numbers), f"total_{name}": sum(numbers)}
    return summary


def _compile_table_pattern(name: str) -> re.Pattern[str]:
    """Compile the pattern that matches a table with its two markers."""
    return re.compile(_TABLE_PATTERN.format(re.escape(name)), re.DOTALL)


def _replace_table(text: str, name: str, body: str) -> str:
    """Replace the text between the markers of a table."""
    # A function, because backslashes in a replacement text would be read as group references.
    return _compile_table_pattern(name).sub(lambda match: f"{match[1]}{body}{match[3]}", text)


def _read_readmes(checkout: Path, files: Sequence[str]) -> dict[Path, str]:
    """Read the READMEs of a checkout that exist.

    An InputError is raised if there is none, or one cannot be read.
    """
    try:
        paths = [path for path in (checkout / name for name in files) if path.exists()]
        texts = {path: path.read_bytes().decode() for path in paths}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"folder {checkout} must be a source checkout with readable READMEs, got {error}") from None
    if not texts:
        raise InputError(f"folder {checkout} must be a source checkout with {files[0]}, got no README")
    return texts
