"""Tissue: density and composition, as `data/tissues.toml` has them."""

from functools import cache

from .records import Record, record
from .tables import data

# No gas at atmospheric pressure is denser, in g/cm3: what is denser attenuates, and is no ambient material.
DENSEST_GAS = 0.02


class Tissue(Record, frozen=True):
    """Density (g/cm3) and mass percent of each element; or a mix of other tissues by volume."""

    density: float | None = None
    composition: dict[str, float] | None = None
    mix: dict[str, float] | None = None


@cache
def tissues() -> dict[str, Tissue]:
    """Name -> tissue or metal, of all that the package has."""
    return record(dict[str, Tissue], data("tissues"), "tissues")
