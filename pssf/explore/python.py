"""The three lines of Python that make an image again."""

from dataclasses import MISSING, fields
from typing import Any

from ..model.knee import Cyst, Knee, Osteophyte
from ..model.protocol import Protocol
from .warm import ENGINE

_OF_PSSF = (Knee, Protocol, Osteophyte, Cyst)


def python_lines(knee: Knee, protocol: Protocol, seed: int) -> str:
    """Lines that give `radiograph`, with the same pixels."""
    return (
        "import pssf\n"
        f"knee, protocol = {_call(knee)}, {_call(protocol)}\n"
        f"radiograph = pssf.simulate(knee, protocol, rng={seed}, engine={ENGINE!r})\n"
    )


def _call(value: Any) -> str:
    """The call that makes a record, with the fields that are not at their defaults."""
    given = [one for one in fields(value) if one.default is MISSING or getattr(value, one.name) != one.default]
    return f"pssf.{type(value).__name__}({', '.join(f'{one.name}={_text(getattr(value, one.name))}' for one in given)})"


def _text(value: Any) -> str:
    if isinstance(value, _OF_PSSF):
        return _call(value)
    if isinstance(value, tuple):
        return f"({''.join(f'{_text(item)}, ' for item in value)})"
    return repr(value)
