"""Guideline: items of reporting guidelines and what answers them, as `data/reporting.toml` has them."""

from functools import cache

import msgspec

from .records import Record, record
from .tables import data


class Item(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One item.

    id, item  its number, and what it asks
    status    yes | no | human | none
    evidence  a file of the study's folder and a key in it, or the reason
    weight    in the score of METRICS
    """

    id: str
    item: str
    status: str
    evidence: str
    weight: float = 0.0


class Guideline(Record, frozen=True):
    """A guideline, its version named."""

    version: str
    items: tuple[Item, ...]


@cache
def guidelines() -> dict[str, Guideline]:
    """Name -> guideline, of all that the package answers."""
    return record(dict[str, Guideline], data("reporting"), "reporting")
