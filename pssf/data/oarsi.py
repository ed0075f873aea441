"""OarsiCuts: from which value on a feature has OARSI grade 1, 2 and 3, as `data/oarsi.toml` has it."""

from functools import cache

from .records import Pair, Record, Triple, record
from .tables import data


class OarsiCuts(Record, frozen=True):
    """All of `data/oarsi.toml`; healthy_mm of each way to measure: the medial and the lateral space."""

    osteophyte_mm: Triple
    narrowing: Triple
    healthy_mm: dict[str, Pair]
    plate: Triple
    attrition_mm: Triple
    cyst_mm: Triple


@cache
def oarsi_cuts() -> OarsiCuts:
    """The package's table."""
    return record(OarsiCuts, data("oarsi"), "oarsi")
