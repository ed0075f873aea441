"""Check that the docstrings of Knee, Osteophyte, Cyst and Protocol agree with the field tables."""

import inspect
from pathlib import Path

import pytest
from tools.field_docstrings import DATACLASSES, write_docstring


def read_module(kind):
    """Read the source of the module that defines a dataclass."""
    return Path(inspect.getsourcefile(DATACLASSES[kind])).read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", DATACLASSES)
def test_each_field_docstring_matches_the_field_table(kind):
    source = read_module(kind)
    remedy = "run `uv run python tests/tools/field_docstrings.py`"
    assert write_docstring(source, kind) == source, remedy


def test_a_docstring_that_differs_from_the_table_is_detected():
    source = read_module("knee").replace("Allowed: 1400 to 2100 mm.", "Allowed: 1300 to 2100 mm.")
    assert write_docstring(source, "knee") != source
