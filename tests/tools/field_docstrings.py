"""Write the fields of Knee, Osteophyte, Cyst and Protocol into their docstrings from ``pssf/data/*_fields.toml``.

Run ``uv run python tests/tools/field_docstrings.py`` after a change of a field table; a test compares tables and
docstrings. Fields without a table entry (``osteophytes``, ``cysts``, ``shape``) keep their docstring text.
"""

import inspect
import re
import textwrap
from dataclasses import MISSING, Field, fields
from pathlib import Path

from pssf.data.knees.field_definitions import FieldSpec, load_field_specs
from pssf.model.detector import Detector
from pssf.model.knee import Cyst, Knee, Osteophyte
from pssf.model.protocol import Protocol

# Maximum number of characters per line, as in pyproject.toml.
LINE_LENGTH = 120
INDENT = " " * 8
# Dataclass of each field table.
DATACLASSES = {"knee": Knee, "osteophyte": Osteophyte, "cyst": Cyst, "protocol": Protocol, "detector": Detector}
_SECTION = re.compile(r'(^class {name}:\n    """.*?\n    Parameters\n    -+\n)(.*?)(?=\n\n)', re.DOTALL | re.MULTILINE)
_ENTRY = re.compile(r"^    (\w+) : [^\n]*\n(?:        [^\n]*\n?)+", re.MULTILINE)


def describe_type(field: Field, spec: FieldSpec) -> str:
    """Format the type and the default of a field.

    Parameters
    ----------
    field : dataclasses.Field
        Field of the dataclass.
    spec : FieldSpec
        Definition of the field.

    Returns
    -------
    str
        Type and default, such as ``float, default 5``.
    """
    kind = "str" if list_words(spec) or (not spec.number_type and not spec.choices) else "int"
    kind = spec.value_type or ("float" if spec.range else kind)
    if field.default is MISSING:
        return kind
    if field.default is None:
        return f"{kind}, optional"
    value = field.default
    shown = (
        repr(value)
        if isinstance(value, tuple)
        else f'"{value}"'
        if isinstance(value, str)
        else f"{value:_}"
        if isinstance(value, int)
        else f"{value:g}"
    )
    return f"{kind}, default {shown}"


def list_words(spec: FieldSpec) -> str:
    """List the allowed words of a field in quotation marks; return an empty text if its values are not words."""
    return ", ".join(f'"{choice}"' for choice in spec.choices or () if isinstance(choice, str))


def describe_field(field: Field, spec: FieldSpec) -> str:
    """Format the docstring entry of one field: type, description and allowed values.

    Parameters
    ----------
    field : dataclasses.Field
        Field of the dataclass.
    spec : FieldSpec
        Definition of the field.

    Returns
    -------
    str
        Entry in numpydoc format, indented as in a class docstring.
    """
    words, kind = list_words(spec), describe_type(field, spec)
    unit = "" if spec.unit.startswith("(") else spec.unit.replace("deg", "degrees")
    allowed = words or f"{spec.allowed_text} {unit}".rstrip()
    head = f"    {field.name} : {kind}"
    in_head = f"    {field.name} : " + kind.replace("str", f"{{{words}}}", 1)
    if words and len(in_head) <= LINE_LENGTH:
        head, allowed = in_head, ""
    text = re.sub(r"'(\w+)'", r'"\1"', spec.description).rstrip(".") + "."
    text += f" Allowed: {allowed}." if allowed else ""
    return f"{head}\n{textwrap.fill(text, LINE_LENGTH, initial_indent=INDENT, subsequent_indent=INDENT)}"


def write_docstring(source: str, kind: str) -> str:
    """Replace the field entries of a dataclass docstring in the source of a module.

    Parameters
    ----------
    source : str
        Text of the module that defines the dataclass.
    kind : {"knee", "osteophyte", "cyst", "protocol"}
        Name of the field table.

    Returns
    -------
    str
        Text of the module with a Parameters section from the table.
    """
    dataclass, specs = DATACLASSES[kind], load_field_specs(kind)
    pattern = re.compile(_SECTION.pattern.replace("{name}", dataclass.__name__), _SECTION.flags)
    found = pattern.search(source)
    assert found is not None, f"{dataclass.__name__} must have a Parameters section"
    written = {entry[1]: entry[0].rstrip("\n") for entry in _ENTRY.finditer(found[2])}
    entries = [
        describe_field(field, specs[field.name]) if field.name in specs else written[field.name]
        for field in fields(dataclass)
    ]
    return source[: found.start(2)] + "\n".join(entries) + source[found.end(2) :]


def main() -> None:
    """Rewrite the docstrings of all dataclasses."""
    for kind, dataclass in DATACLASSES.items():
        module = Path(inspect.getsourcefile(dataclass) or "")
        module.write_text(write_docstring(module.read_text(encoding="utf-8"), kind), encoding="utf-8")


if __name__ == "__main__":
    main()
