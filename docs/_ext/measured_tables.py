"""Define directives and commands for the measured tables of the validation pages.

``measured-table`` and ``measured-picture`` show a table or picture with command, date and machine of its measurement.
``stale-tables`` lists tables and pictures that were measured with other code, other data or another command. The
commands are::

    uv run python docs/_ext/measured_tables.py stale
    uv run python docs/_ext/measured_tables.py update RUN_FOLDER [...]
    uv run python docs/_ext/measured_tables.py confirm NAME [...] --by TEXT
"""

import argparse
import re
import sys
from datetime import date
from fnmatch import fnmatch
from pathlib import Path

# Python finds table_store because this folder is on the import path, both for scripts and for a Sphinx build.
from table_store import StaleEntry, TableStore

try:
    from docutils import nodes
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.util import logging
    from sphinx.util.docutils import SphinxDirective
    from sphinx.util.typing import ExtensionMetadata
except ImportError:  # The command line of this file works without Sphinx.
    SphinxDirective = object  # type: ignore[assignment, misc]


# Space that prevents a line break.
NO_BREAK = "\N{NO-BREAK SPACE}"


class MeasuredTable(SphinxDirective):
    """Show a measured table with the command, date and machine of its measurement."""

    required_arguments = 1

    def run(self) -> "list[nodes.Node]":
        """Make the caption and the table."""
        from field_lists import make_table

        store, name = TableStore(), self.arguments[0]
        layout = store.load_layouts()[name]
        self.env.note_dependency(str(store.file_of(layout)))
        heads, *rows = store.load_cells(layout)
        table = make_table(tuple(heads), [tuple(map(_keep_together, row)) for row in rows], (1,) * len(heads))
        # The browser chooses the widths of the columns.
        table["classes"] += ["measured", "colwidths-auto"]
        return [*_make_caption(self, store, name), table]


class MeasuredPicture(SphinxDirective):
    """Show a picture of measured values with the command, date and machine of its measurement."""

    required_arguments = 1

    def run(self) -> "list[nodes.Node]":
        """Make the caption and the picture."""
        store, name = TableStore(), self.arguments[0]
        layout = store.load_layouts()[name]
        image = nodes.image(uri=f"/validation/tables/{name}.png", alt=layout.alt, classes=["gallery-picture"])
        return [*_make_caption(self, store, name), image]


class StaleTables(SphinxDirective):
    """List the tables and pictures that are stale."""

    def run(self) -> "list[nodes.Node]":
        """Make a sentence on the number of stale entries, and a table with one row per entry."""
        self.env.note_reread()
        store = TableStore()
        stale, count = store.list_stale(), len(store.load_layouts())
        logger = logging.getLogger(__name__)
        for entry in stale:
            logger.info("stale: %s", format_entry(entry))
        if not stale:
            return [nodes.paragraph(text=f"All {count} tables and pictures are up to date.")]
        text = f"{len(stale)} of {count} tables and pictures are stale, because code, data or command changed."
        return [nodes.paragraph(text=text), self._make_table(stale)]

    def _make_table(self, stale: list[StaleEntry]) -> "nodes.table":
        """Make the table of stale entries, with links to their pages."""
        from field_lists import make_table

        rows = [(entry.name, entry.page, entry.date, entry.reason) for entry in stale]
        table = make_table(("name", "page", "measured on", "reason"), rows, (28, 20, 14, 38), literal=(0,))
        (body,) = table.findall(nodes.tbody)
        for row, entry in zip(body.children, stale, strict=True):
            link = pending_xref(
                "", nodes.inline(text=entry.page), refdoc=self.env.docname, refdomain="std", reftype="doc",
                reftarget=entry.page, refexplicit=True, refwarn=True,
            )  # fmt: skip
            row.children[1].children[0].children = []
            row.children[1].children[0] += link
        return table


def _keep_together(text: str) -> str:
    """Replace the spaces in intervals and in sizes such as 512 x 512 by no-break spaces."""
    text = re.sub(r"\([^()]{1,20}\)", lambda found: found[0].replace(" ", NO_BREAK), text)
    return text.replace(" x ", f"{NO_BREAK}x{NO_BREAK}")


def format_entry(entry: StaleEntry) -> str:
    """Format a stale entry as one line.

    Parameters
    ----------
    entry : StaleEntry
        Stale table or picture.

    Returns
    -------
    str
        Name, page, date and reason.
    """
    return f"{entry.name} ({entry.page or 'on no page'}), measured on {entry.date}: {entry.reason}"


def _make_caption(directive: SphinxDirective, store: TableStore, name: str) -> "list[nodes.Node]":
    """Make the caption of a table: command, date and machine of the measurement, and evidence of a confirmation."""
    directive.env.note_reread()
    record = store.load_record(name)
    stale = store.explain_staleness(store.load_layouts()[name])
    line = nodes.paragraph("", f"Measured on {record['date']} by ", classes=["measured"])
    line += nodes.literal(text=f"uv run {record['command']}")
    note = f"; {record['note']}" if record["note"] else ""
    line += nodes.Text(f" ({record['machine']}{note}).")
    if "confirmed" in record:
        line += nodes.Text(f" Confirmed on {record['confirmed']['date']}: {record['confirmed']['by']}.")
    if stale:
        line += nodes.strong(text=f" Stale: {stale}.")
    return [line]


def setup(app: "Sphinx") -> "ExtensionMetadata":
    """Register the directives."""
    app.add_directive("measured-table", MeasuredTable)
    app.add_directive("measured-picture", MeasuredPicture)
    app.add_directive("stale-tables", StaleTables)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def main(arguments: list[str], store: TableStore | None = None) -> int:
    """Run one of the commands update, stale and confirm.

    Parameters
    ----------
    arguments : list of str
        Words of the command line.
    store : TableStore or None
        Store of the tables; None for the store of this source folder.

    Returns
    -------
    int
        Exit code: 0 for success, 1 if `stale` finds a stale table, 2 for an error.
    """
    given = _make_parser().parse_args(arguments)
    try:
        code: int = given.run(store or TableStore(), given)
    except (ValueError, OSError) as error:
        print(f"measured_tables: {error}", file=sys.stderr)
        return 2
    return code


def _make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    parser = argparse.ArgumentParser(description="Measured tables of the validation pages.")
    commands = parser.add_subparsers(required=True)
    update = commands.add_parser("update", help="store the tables and pictures measured by the given runs")
    update.add_argument(
        "folders", nargs="+", type=Path, metavar="RUN_FOLDER", help="output folder of a run (its --out)"
    )
    update.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="NAME",
        help="names of tables and pictures, or patterns such as 'films_*'",
    )
    update.add_argument(
        "--checkout", type=Path, help="source folder with which the runs were made; default: the folder of this site"
    )
    update.add_argument(
        "--rename", nargs="+", default=[], metavar="OLD=NEW", help="columns that were renamed after the runs"
    )
    for name in ("command", "date", "machine", "note"):
        update.add_argument(f"--{name}", help=f"{name} of the runs; default: the value in run.json")
    update.set_defaults(run=_update)
    stale = commands.add_parser("stale", help="list stale tables; exit code 1 if any table is stale")
    stale.set_defaults(run=_list_stale)
    confirm = commands.add_parser("confirm", help="record that tables are unchanged with the current code and data")
    confirm.add_argument(
        "names", nargs="+", metavar="NAME", help="names of tables and pictures, or patterns such as 'films_*'"
    )
    confirm.add_argument("--by", required=True, metavar="TEXT", help="evidence, such as equal hashes of a quick study")
    confirm.set_defaults(run=_confirm)
    return parser


def _update(store: TableStore, given: argparse.Namespace) -> int:
    """Store the tables that the given runs measured, and print their names."""
    names = _find_names(store, given.only)
    origin = {
        key: value for key in ("command", "date", "machine", "note") if (value := getattr(given, key)) is not None
    }
    renamed = dict(pair.split("=", 1) for pair in given.rename)
    for folder in given.folders:
        updated, skipped = store.update(folder, names, checkout=given.checkout, renamed=renamed, origin=origin)
        print("\n".join(f"{folder}: {name}" for name in updated))
        print("\n".join(skipped), file=sys.stderr)
        if not updated:
            raise ValueError(f"folder {folder} contains no table or picture that its command measures")
    return 0


def _list_stale(store: TableStore, given: argparse.Namespace) -> int:
    """Print the stale tables."""
    stale = store.list_stale()
    for entry in stale:
        print(format_entry(entry))
    return 1 if stale else 0


def _confirm(store: TableStore, given: argparse.Namespace) -> int:
    """Confirm the given tables, and print their names."""
    for name in _find_names(store, given.names):
        store.confirm(name, given.by.rstrip("."), date.today().isoformat())
        print(name)
    return 0


def _find_names(store: TableStore, patterns: list[str]) -> tuple[str, ...]:
    """List the tables and pictures whose names match at least one pattern."""
    names = list(store.load_layouts())
    for pattern in patterns:
        if not any(fnmatch(name, pattern) for name in names):
            raise ValueError(f"name must be one of {', '.join(names)}, got {pattern}")
    return tuple(name for name in names if any(fnmatch(name, pattern) for pattern in patterns))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
