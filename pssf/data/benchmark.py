"""FrozenSet: what is said of the frozen data set, as `data/benchmark.toml` has it; and the hashes of some of it."""

from functools import cache

from .records import Record, record
from .tables import data


class FrozenSet(Record, frozen=True):
    """A data set that is made by one command and never changed.

    preset, seed  the cohort
    splits        how many there are
    url           of a page about it
    """

    preset: str
    seed: int
    splits: int
    version: str
    title: str
    description: str
    keywords: tuple[str, ...]
    date: str
    license: str
    creator: str
    url: str


@cache
def frozen_set() -> FrozenSet:
    """The one that there is."""
    return record(FrozenSet, data("benchmark"), "benchmark")


@cache
def frozen_hashes() -> dict[str, str]:
    """Person -> hash of the pixels of all its radiographs, see `benchmark.hashes`, of those that are written down."""
    return record(dict[str, dict[str, str]], data("benchmark_hashes"), "benchmark_hashes")["sha256"]
