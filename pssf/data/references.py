"""References: published or independently computed values, as `data/reference.toml` has them."""

from functools import cache

from .records import Numbers, Pair, Record, record
from .tables import data


class Known(Record, frozen=True):
    """A value, or a range that holds for any usual case, and where it is from."""

    source: str
    value: float | None = None
    range: Pair | None = None


class Size(Record, frozen=True):
    """Mean and standard deviation of a size, of men and women or of both together; mm, degrees.

    people  over the plateau's width, of people's bones by the same measure
    """

    source: str
    people: float | None = None
    male: Pair | None = None
    female: Pair | None = None
    both: Pair | None = None


class ScatterCases(Record, frozen=True):
    """Rows of kV, thickness (mm), air gap (mm), then what was found; see the table."""

    limb: tuple[tuple[float, float, float, float, float], ...]
    slab: tuple[tuple[float, float, float, float], ...]


class Criterion(Record, frozen=True):
    """What a guide to positioning asks of a view."""

    view: str
    asked: str


class References(Record, frozen=True):
    """All of `data/reference.toml`.

    spectrum     tube kV -> photons/mm2/mAs at 1 m, mean keV
    attenuation  tissue -> 1/cm at 40 and 60 keV
    scatter      over the open beam or the primary
    morphometry  size -> mean and standard deviation
    texture      quantity -> range of real films
    quality      quantity of `pssf quality` -> value or range
    views        quantity of `pssf accuracy --tables views` -> value or range
    criteria     quantity of `pssf accuracy --tables criteria` -> what is asked
    beam         "kV_mmAl" -> first and second HVL (mm Al), mean keV, photons/mm2/mAs, air kerma (uGy/mAs) at 1 m
    """

    spectrum: dict[str, Pair]
    attenuation: dict[str, Pair]
    scatter: ScatterCases
    morphometry: dict[str, Size]
    texture: dict[str, Known]
    quality: dict[str, Known]
    views: dict[str, Known]
    criteria: dict[str, Criterion]
    beam: dict[str, Numbers]


@cache
def references() -> References:
    """What the package is held against."""
    return record(References, data("reference"), "reference")
