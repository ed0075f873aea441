"""Define a directive that lists the columns of the CSV files described in docs/reference/columns.toml."""

import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata

COLUMNS = Path(__file__).parents[1] / "reference" / "columns.toml"


def load_columns() -> dict[str, Any]:
    """Load the descriptions of all CSV files.

    Returns
    -------
    dict of str to dict
        Entries ``text``, ``group``, ``row`` and ``columns`` of each file, keyed by file name.
    """
    return tomllib.loads(COLUMNS.read_text(encoding="utf-8"))


def list_unknown_columns(folder: Path) -> list[str]:
    """List the columns of the CSV files in a folder that the documentation does not describe.

    Parameters
    ----------
    folder : Path
        Output folder of a command such as ``pssf study``.

    Returns
    -------
    list of str
        One line per missing description: ``FILE: COLUMN``, or ``FILE`` if no column of the file is described.
    """
    import csv

    known, missing = load_columns(), []
    for path in sorted(folder.rglob("*.csv")):
        entry = next((known[name] for name in known if fnmatch(path.name, name)), None)
        if entry is None:
            missing.append(path.name)
            continue
        with path.open(newline="", encoding="utf-8") as file:
            heads = next(csv.reader(file), [])
        patterns = [name.strip() for names in entry["columns"] for name in names.split(",")]
        patterns = [*patterns, *entry["columns"]]
        missing += [f"{path.name}: {head}" for head in heads if not any(fnmatch(head, one) for one in patterns)]
    return missing


class ColumnList(SphinxDirective):
    """List the CSV files of one group with the meaning of every column."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Make a section with a definition list per file."""
        self.env.note_dependency(str(COLUMNS))
        made: list[nodes.Node] = []
        for file, entry in load_columns().items():
            if entry["group"] != self.arguments[0]:
                continue
            section = nodes.section(ids=[nodes.make_id(file)], names=[file])
            section += nodes.title("", "", nodes.literal(text=file))
            section += nodes.paragraph(text=f"{entry['text']} One row per {entry['row']}.")
            entries = nodes.definition_list(classes=["column-list"])
            for names, meaning in entry["columns"].items():
                term = nodes.term()
                for number, name in enumerate(_split(names)):
                    term += [nodes.Text(", ")] if number else []
                    term += nodes.literal(text=name)
                entries += nodes.definition_list_item("", term, nodes.definition("", nodes.paragraph(text=meaning)))
            section += entries
            made.append(section)
        return made


def _split(names: str) -> list[str]:
    """Split a key of ``columns`` into column names at the commas; a key such as ICC(2,1) is one name."""
    return [names] if "(" in names else [name.strip() for name in names.split(",")]


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directive."""
    app.add_directive("column-list", ColumnList)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    import sys

    print("\n".join(list_unknown_columns(Path(sys.argv[1]))) or "every column is described")
