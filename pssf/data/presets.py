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
    grades     table that knees are drawn by, see `draw_knee`
    doses      factors of a protocol's mAs, and
    tilts_deg  degrees more of its beam angle: each protocol is taken at every one of both
    numbered   subjects and knees: by grade, one after the other, or by chance, so that no name tells a grade; of the
               same images
    """

    knees: tuple[int, ...]
    bilateral: int
    protocols: tuple[str, ...]
    repeats: int
    retested: int
    exposures: str = "fixed"
    grades: str = "paper"
    doses: tuple[float, ...] = (1.0,)
    tilts_deg: tuple[float, ...] = (0.0,)
    numbered: str = "by grade"
    matrix: int = 0
    settings: tuple[str, ...] = ()


@cache
def presets() -> dict[str, Preset]:
    """Name -> preset, of all that the package has."""
    return record(dict[str, Preset], data("presets"), "presets")
