"""Tissue: density and composition, as `data/tissues.toml` has them."""

from functools import cache

from .records import Record, record
from .tables import data


class Tissue(Record, frozen=True):
    """Density (g/cm3) and mass percent of each element; or a mix of other tissues by volume."""

    density: float | None = None
    composition: dict[str, float] | None = None
    mix: dict[str, float] | None = None


@cache
def tissues() -> dict[str, Tissue]:
    """Name -> tissue or metal, of all that the package has."""
    return record(dict[str, Tissue], data("tissues"), "tissues")
