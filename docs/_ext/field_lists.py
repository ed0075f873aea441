"""Define directives that list the fields of a knee and of a protocol from the tables of the package."""

from dataclasses import fields
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata

import pssf
from pssf.model.field_listing import list_fields

PROTOCOLS = Path(__file__).parents[2] / "protocols"
DATA = Path(pssf.__file__).parent / "data"


class FieldList(SphinxDirective):
    """List every field of a knee or of a protocol: meaning, unit, allowed values, default, source."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Make one entry per field, each with an anchor for links."""
        kind = self.arguments[0]
        for file in DATA.glob("*_fields.toml"):
            self.env.note_dependency(str(file))
        entries = nodes.definition_list(classes=["field-list-pssf"])
        for row in list_fields(kind):
            entries += self._make_entry(kind, row)
        return [entries]

    def _make_entry(self, kind: str, row: dict[str, str]) -> nodes.definition_list_item:
        """Make the definition-list entry of one field."""
        identifier = f"{kind}-{row['field']}".replace(".", "-").replace("_", "-")
        term = nodes.term("", "", nodes.literal(text=row["field"]), ids=[identifier])
        if row["unit"]:
            term += nodes.inline(text=f"  {row['unit']}", classes=["field-unit"])
        text = nodes.paragraph(text=_end_sentence(row["what"]))
        parts = [
            ("Allowed", row["allowed"]),
            ("Default", row["default"] or _describe_missing(row)),
            ("Source", row["source"]),
        ]
        facts = nodes.field_list(classes=["field-facts"])
        for name, value in parts:
            if value:
                body = nodes.field_body("", nodes.paragraph(text=value))
                facts += nodes.field("", nodes.field_name(text=name), body)
        return nodes.definition_list_item("", term, nodes.definition("", text, facts))


class ProtocolTable(SphinxDirective):
    """Show each protocol of the package with the fields that differ from its base."""

    def run(self) -> list[nodes.Node]:
        """Make a table with one row per protocol."""
        import tomllib

        rows = []
        for file in sorted(PROTOCOLS.glob("*.toml")):
            self.env.note_dependency(str(file))
            given = tomllib.loads(file.read_text(encoding="utf-8"))
            base = given.pop("base", "")
            given.pop("name", None)
            changes = ", ".join(f"{key} = {_show(value)}" for key, value in given.items())
            rows.append((file.stem, base, changes if base else "all fields"))
        return [make_table(("protocol", "base", "fields set by the protocol"), rows, (20, 20, 60), literal=(0, 1))]


def make_table(
    heads: tuple[str, ...], rows: list[tuple[str, ...]], widths: tuple[int, ...], literal: tuple[int, ...] = ()
) -> nodes.table:
    """Make a table of texts; columns whose index is in `literal` are shown as code."""
    group = nodes.tgroup(cols=len(heads))
    group.extend(nodes.colspec(colwidth=width) for width in widths)
    head = nodes.row()
    head.extend(nodes.entry("", nodes.paragraph(text=text)) for text in heads)
    group += nodes.thead("", head)
    body = nodes.tbody()
    for row in rows:
        line = nodes.row()
        for index, text in enumerate(row):
            inner = nodes.literal(text=text) if index in literal and text else nodes.Text(text)
            line += nodes.entry("", nodes.paragraph("", "", inner))
        body += line
    group += body
    return nodes.table("", group, classes=["table", "wide-table"])


def _show(value: object) -> str:
    """Format a value as in a TOML file."""
    return f'"{value}"' if isinstance(value, str) else str(value)


def _describe_missing(row: dict[str, str]) -> str:
    """Describe the default of a field without a listed default; say that the field is required if it has no default."""
    if "." not in row["field"]:
        return "none; the field is required"
    kind, name = row["field"].split("s.", 1)
    of = {"osteophyte": pssf.Osteophyte, "cyst": pssf.Cyst}[kind]
    known = {field.name: field.default for field in fields(of)}
    default = known.get(name)
    return str(default) if isinstance(default, float) else "none; the field is required"


def _end_sentence(text: str) -> str:
    """Add a full stop to a text that has none."""
    return text if text.endswith(".") else f"{text}."


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directives."""
    app.add_directive("field-list", FieldList)
    app.add_directive("protocol-table", ProtocolTable)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
