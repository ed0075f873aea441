"""Guidelines: items of reporting guidelines, as `data/reporting.toml` has them."""

from functools import cache

from .records import Record, record
from .tables import data


class Guideline(Record, frozen=True):
    """Rows of id, what is asked, status, evidence or reason, and for METRICS a weight."""

    version: str
    items: tuple[tuple[str | float, ...], ...]


@cache
def guidelines() -> dict[str, Guideline]:
    """Name -> guideline, of all that the package answers."""
    return record(dict[str, Guideline], data("reporting"), "reporting")


@cache
def ibsi_tags() -> dict[str, dict[str, str]]:
    """Family -> feature -> its tag at the IBSI; and "departures": feature -> how it departs from their definition."""
    return record(dict[str, dict[str, str]], data("ibsi"), "ibsi")
