"""Tissues and implant materials: density and elemental composition (``data/tissues.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record

# Density above which a material is not a gas at atmospheric pressure, in g/cm3. Denser materials cannot be the ambient
# material.
DENSEST_GAS_G_PER_CM3 = 0.02


class Tissue(Record, frozen=True):
    """Material with an elemental composition, or mixture of other materials.

    Attributes
    ----------
    density : float or None
        Density, in g/cm3; None for a mixture.
    composition : dict of str to float or None
        Mass percent of each chemical element; None for a mixture.
    mix : dict of str to float or None
        Volume fraction of each material in a mixture; None for a material with a composition.
    """

    density: float | None = None
    composition: dict[str, float] | None = None
    mix: dict[str, float] | None = None


@cache
def load_tissues() -> dict[str, Tissue]:
    """Load all tissues and implant materials.

    Returns
    -------
    dict of str to Tissue
        Materials, keyed by name.
    """
    return parse_record(dict[str, Tissue], load_data_table("tissues"), "tissues")
