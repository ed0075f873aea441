"""Exposures: how takings of one view vary, as `data/exposures.toml` has it."""

from functools import cache

from .records import Pair, Record, record
from .tables import data


class Field(Record, frozen=True):
    """Least and greatest side of the collimated field."""

    width_mm: Pair
    height_mm: Pair


class Marker(Record, frozen=True):
    """Share of takings that have one."""

    share: float


class Exposures(Record, frozen=True):
    """Field of a protocol -> its standard deviation, step, or deviation of its logarithm; field of view and marker."""

    spread: dict[str, float]
    step: dict[str, float]
    factor: dict[str, float]
    field: Field
    marker: Marker


@cache
def exposures() -> Exposures:
    """How the package draws a taking."""
    return record(Exposures, data("exposures"), "exposures")
