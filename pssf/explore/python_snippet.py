"""Generation of Python code that reproduces the image on the explore page."""

from dataclasses import MISSING, fields
from typing import Any

from ..model.knee import Cyst, Knee, Osteophyte
from ..model.protocol import Protocol
from .stage_cache import ENGINE

_PSSF_TYPES = (Knee, Protocol, Osteophyte, Cyst)


def format_python_lines(knee: Knee, protocol: Protocol, seed: int, processing: str) -> str:
    """Generate Python code that simulates and renders the radiograph shown on the explore page.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    protocol : Protocol
        Acquisition protocol.
    seed : int
        Noise seed.
    processing : str
        Display processing selected on the page; ``"linear"`` for pixels without display processing.

    Returns
    -------
    str
        Python code that assigns the variable ``radiograph`` and, unless `processing` is ``"linear"``, the variable
        ``image``.
    """
    rendering = f"image = pssf.render_for_display(radiograph, bits=16, processing={processing!r})\n"
    return (
        "import pssf\n"
        f"knee, protocol = {_format_call(knee)}, {_format_call(protocol)}\n"
        f"radiograph = pssf.simulate(knee, protocol, rng={seed}, engine={ENGINE!r})\n"
        f"{'' if processing == 'linear' else rendering}"
    )


def _format_call(value: Any) -> str:
    """Generate the constructor call of an object, with only the fields that differ from the defaults."""
    given = [one for one in fields(value) if one.default is MISSING or getattr(value, one.name) != one.default]
    return (
        f"pssf.{type(value).__name__}"
        f"({', '.join(f'{one.name}={_format_value(getattr(value, one.name))}' for one in given)})"
    )


def _format_value(value: Any) -> str:
    """Convert a value to Python source code."""
    if isinstance(value, _PSSF_TYPES):
        return _format_call(value)
    if isinstance(value, tuple):
        return f"({''.join(f'{_format_value(item)}, ' for item in value)})"
    return repr(value)
