"""Define a directive that lists every command and option, as read from the Typer application.

The extension `sphinxcontrib-typer` cannot be used: it needs the terminal output of Rich, which this application does
not use, and stops with an AttributeError.
"""

import os
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata


class CommandLine(SphinxDirective):
    """Make one section per command, with its text, arguments and options."""

    def run(self) -> list[nodes.Node]:
        """Walk through the commands in the order of ``pssf --help``."""
        import typer

        import pssf.cli
        from pssf.cli import app

        for file in Path(pssf.cli.__file__).parent.glob("*.py"):
            self.env.note_dependency(str(file))
        # A fixed terminal width makes the help texts independent of the machine that builds the site.
        os.environ["COLUMNS"] = "100"
        root = typer.main.get_command(app)
        return [self._make_section(command, f"pssf {name}") for name, command in root.commands.items()]  # type: ignore[attr-defined]

    def _make_section(self, command: Any, path: str) -> nodes.section:
        """Make the section of a command, with one nested section per subcommand."""
        import typer

        context = typer.Context(command, info_name=path)
        section = nodes.section(ids=[path.replace(" ", "-")], names=[path])
        section += nodes.title("", "", nodes.literal(text=path))
        for text in re.split(r"\n\s*\n", (command.help or "").strip()):
            section += nodes.paragraph(text=" ".join(text.split()))
        usage = " ".join(command.collect_usage_pieces(context))
        block = nodes.literal_block(text=f"pssf{path.removeprefix('pssf')} {usage}")
        block["language"] = "text"
        section += block
        entries = nodes.definition_list(classes=["column-list"])
        for parameter in command.params:
            record = parameter.get_help_record(context)
            if record is None or record[0].strip() == "--help":
                continue
            name, text = record
            identifier = f"{path} {parameter.name}".replace(" ", "-").replace("_", "-")
            term = nodes.term("", "", nodes.literal(text=" ".join(name.split())), ids=[identifier])
            entries += nodes.definition_list_item(
                "", term, nodes.definition("", nodes.paragraph("", *_split_default(" ".join(text.split()))))
            )
        section += entries
        for name, inner in getattr(command, "commands", {}).items():
            section += self._make_section(inner, f"{path} {name}")
        return section


def _split_default(text: str) -> list[nodes.Node]:
    """Split "[default: ...]" or "[required]" from the end of a help text, and show it in another style."""
    found = re.search(r"\s*\[((?:default: .*|required))\]$", text)
    if not found:
        return [nodes.Text(text)]
    return [
        nodes.Text(text[: found.start()] + " "),
        nodes.inline(text=found.group(1)[0].upper() + found.group(1)[1:] + ".", classes=["field-unit"]),
    ]


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directive."""
    app.add_directive("command-line", CommandLine)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
