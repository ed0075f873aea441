"""Measured tables in the READMEs of a source checkout: rows replace what stands between the markers of a table.

    <!-- table: engines -->
    <!-- /table -->

What a table shows of its rows, and the command that measures them, is in `data/readme.toml`. Nothing is written by
hand: a caption above each table says when, on what kind of machine and by which command it was measured.
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
from ..core.parallel import cores
from ..data.readmes import Layout, Readmes, readmes
from .atomic import write_bytes

Row = Mapping[str, Any]
_MARKED = r"(<!-- table: {} -->\n)((?:(?!<!-- table: ).)*?)(<!-- /table -->)"


@dataclass(frozen=True, kw_only=True)
class Origin:
    """When, on what and with which options rows were measured.

    day      as 2026-11-22
    machine  kind of machine, see `machine_class`
    options  of the run, for the command in the caption
    note     what else a reader must know of it
    """

    day: str
    machine: str
    options: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""


def machine_class() -> str:
    """Kind of the machine that this runs on: cores that may be used, processor, system, Python."""
    processor = platform.machine().replace("_", "-")
    release = ".".join(platform.python_version_tuple()[:2])
    return f"{cores()} cores, {processor}, {platform.system()}, Python {release}"


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """The READMEs of a source checkout, which take tables; none where `folder` is None.

    origin  of what they take
    """

    folder: Path | None
    origin: Origin

    def take(
        self, measured: Mapping[str, Sequence[Row]], pictures: Iterable[Path] = (), measured_with: Path | None = None
    ) -> list[Path]:
        """Put in what was measured; returns the paths of what was written.

        measured       name -> rows
        pictures       of them, those that the READMEs show are copied
        measured_with  file that was written when the rows were measured, if that was by an earlier run
        raises         InputError as `write_tables`
        """
        if self.folder is None:
            return []
        origin = self.origin
        if measured_with is not None:
            origin = replace(origin, day=date.fromtimestamp(measured_with.stat().st_mtime).isoformat())
        written = write_tables(self.folder, measured, origin)
        tables = readmes()
        for picture in pictures:
            place = tables.picture.get(picture.stem) if picture.suffix == ".png" else None
            if place is not None:
                written.append(self.folder / place)
                write_bytes(written[-1], picture.read_bytes())
        return written


def open_checkout(folder: Path | None, measured: Collection[str], **options: Any) -> Checkout:
    """A source checkout that can take what is to be measured here and now; to be opened before, for it notes what else
    the machine does.

    measured  names of what is to be measured
    options   of the run, for the captions
    raises    InputError as `require_checkout`
    """
    if folder is not None:
        require_checkout(folder, measured)
    # Windows does not tell its load.
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    note = "beside other work" if load > cores() / 2 else ""
    day = date.today().isoformat()
    return Checkout(folder=folder, origin=Origin(day=day, machine=machine_class(), options=options, note=note))


def require_checkout(checkout: Path, measured: Collection[str]) -> None:
    """Refuse a folder whose READMEs cannot take the tables of what is to be measured.

    measured  names of what is measured
    raises    InputError for a folder with none of the READMEs, a name that no table shows, or a table without markers
    """
    tables = readmes()
    texts = _read(checkout, tables.files).values()
    for source in measured:
        known = sorted({layout.rows or name for name, layout in tables.table.items()})
        require_choice("table of the READMEs", source, known)
        for name in tables.shown(source):
            if not any(_pattern(name).search(text) for text in texts):
                raise InputError(
                    f"READMEs of {checkout} have no table {name!r}; allowed: one between the lines <!-- table: {name} "
                    f"--> and <!-- /table -->, in {' or '.join(tables.files)}"
                )


def write_tables(checkout: Path, measured: Mapping[str, Sequence[Row]], origin: Origin) -> list[Path]:
    """Put rows into the READMEs of a source checkout; returns the paths of those that carry a table of them.

    checkout  folder with README.md, meshes/README.md, ...
    measured  name of what was measured -> its rows
    raises    InputError as `require_checkout`, for a row without a column that is to be shown, for an unwritable file
    """
    require_checkout(checkout, measured.keys())
    tables = readmes()
    bodies = {
        name: table_text(name, rows, origin, tables)
        for source, rows in measured.items()
        for name in tables.shown(source)
    }
    written = []
    for path, before in _read(checkout, tables.files).items():
        after = before
        for name, body in bodies.items():
            after = _replaced(after, name, body)
        if any(_pattern(name).search(before) for name in bodies):
            written.append(path)
        if after != before:
            write_bytes(path, after.encode())
    return written


def table_text(name: str, rows: Sequence[Row], origin: Origin, tables: Readmes) -> str:
    """Caption and Markdown table, with an empty line at the end.

    raises  InputError for rows without a column that is to be shown
    """
    layout = tables.table[name]
    command = layout.command.format_map(dict(origin.options))
    try:
        lines = _grid(layout, rows)
    except KeyError as error:
        raise InputError(f"table {name}: rows have no column {error}; allowed: {', '.join(rows[0])}") from None
    headings = headings_of(layout)
    parts = [headings, ["---"] * len(headings), *lines]
    text = "\n".join(f"| {' | '.join(cell.strip().replace('|', chr(92) + '|') for cell in line)} |" for line in parts)
    caption = ", ".join(part for part in (origin.day, origin.machine, f"`uv run {command}`", origin.note) if part)
    return f"*{caption}*\n\n{text}\n\n"


def headings_of(layout: Layout) -> list[str]:
    """The headings of a table, in their order."""
    return [*layout.columns, *layout.headings]


class _Cells(string.Formatter):
    """`str.format` for cells: nothing for what is missing, numbers from text where a format asks for them."""

    def format_field(self, value: Any, format_spec: str) -> str:
        # A value that differs from itself is NaN.
        if value is None or value == "" or value != value:
            return ""
        if isinstance(value, str) and format_spec[-1:] in tuple("eEfFgG%"):
            value = float(value)
        return format(value, format_spec)

    def convert_field(self, value: Any, conversion: Any) -> Any:
        return str(value).replace("_", " ") if conversion == "p" else super().convert_field(value, conversion)


def _grid(layout: Layout, rows: Sequence[Row]) -> list[list[str]]:
    """The cells of each line; rows whose first columns agree share a line where there are columns across it."""
    cells = _Cells()
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for number, row in enumerate(_grouped(layout, [row for row in rows if _fits(row, layout.only)])):
        values = {name: layout.words.get(name, {}).get(str(value), value) for name, value in row.items()}
        first = tuple(cells.vformat(text, (), values) for text in layout.columns.values())
        line = lines.setdefault(first if layout.across else (*first, str(number)), {})
        if layout.across:
            line[cells.vformat(layout.across, (), values)] = cells.vformat(layout.cell, (), values)
    return [
        [*first[: len(layout.columns)], *(line.get(heading, "") for heading in layout.headings)]
        for first, line in lines.items()
    ]


def _fits(row: Row, only: Sequence[Mapping[str, Sequence[Any]]]) -> bool:
    return not only or any(all(row[name] in values for name, values in one.items()) for one in only)


def _grouped(layout: Layout, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The rows, or one for each group of them."""
    if layout.by is None:
        return [dict(row) for row in rows]
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in layout.by), []).append(row)
    return [_summary(group, layout.by) for group in groups.values()]


def _summary(group: Sequence[Row], by: Sequence[str]) -> dict[str, Any]:
    summary: dict[str, Any] = {**group[0], "count": len(group)}
    for name in group[0]:
        numbers = [row[name] for row in group if isinstance(row[name], int | float)]
        if numbers and name not in by:
            summary |= {f"least_{name}": min(numbers), f"most_{name}": max(numbers), f"total_{name}": sum(numbers)}
    return summary


def _pattern(name: str) -> re.Pattern[str]:
    return re.compile(_MARKED.format(re.escape(name)), re.DOTALL)


def _replaced(text: str, name: str, body: str) -> str:
    # A function, since a replacement's backslashes would be read as references.
    return _pattern(name).sub(lambda match: f"{match[1]}{body}{match[3]}", text)


def _read(checkout: Path, files: Sequence[str]) -> dict[Path, str]:
    """The READMEs of a checkout that are there.

    raises  InputError where there is none, or one cannot be read
    """
    try:
        paths = [path for path in (checkout / name for name in files) if path.exists()]
        texts = {path: path.read_bytes().decode() for path in paths}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"READMEs of {checkout} cannot be read ({error}); allowed: a source checkout") from None
    if not texts:
        raise InputError(f"folder {checkout} has no README; allowed: a source checkout, with {files[0]}")
    return texts
