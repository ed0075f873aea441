"""Preset: who is in a cohort and how it is taken, as `data/presets.toml` has it."""

from functools import cache

from .records import Record, record
from .tables import data


class Preset(Record, frozen=True):
    """A cohort by name.

    knees      count of each grade
    bilateral  subjects who give both knees
    protocols  names
    repeats    random splits by subject
    retested   knees taken again
    exposures  fixed: each protocol as it is; drawn: as takings vary, see `draw_exposure`
    grade_table  that knees are sampled from, see `draw_knee`
    doses      factors of a protocol's mAs, and
    tilts_deg  degrees more of its beam angle: each protocol is taken at every one of both
    """

    knees: tuple[int, ...]
    bilateral: int
    protocols: tuple[str, ...]
    repeats: int
    retested: int
    exposures: str = "fixed"
    grade_table: str = "population"
    doses: tuple[float, ...] = (1.0,)
    tilts_deg: tuple[float, ...] = (0.0,)
    matrix: int = 0
    settings: tuple[str, ...] = ()


@cache
def presets() -> dict[str, Preset]:
    """Name -> preset, of all that the package has."""
    return record(dict[str, Preset], data("presets"), "presets")
