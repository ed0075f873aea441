"""Localisation: how the joint is looked for and when it is refused, as `data/localisation.toml` has it, and by what its
side is told, as `data/side_pattern.toml` has it.
"""

from functools import cache

from .records import Numbers, Pair, Record, Rows, record
from .tables import data


class PatchLaw(Record, frozen=True):
    """What is cut out of a template about its medial joint line, and how; see the table."""

    pitch_mm: float
    up_mm: float
    down_mm: float
    lateral_mm: float
    medial_mm: float
    height_mm: float
    turns_deg: Numbers
    tile_mm: float


class Search(Record, frozen=True):
    """Sizes and places that are looked at; see the table."""

    scale_step: float
    known_scale: Pair
    smaller_scale: float
    plateau_share: Pair
    large_share: float
    narrow_scales: Numbers
    reach_mm: float
    least_seen: float
    candidates: int
    nearly: float
    pixel_heights: Numbers


class Chance(Record, frozen=True):
    """What a score is by chance; see the table."""

    sd: float
    cell_mm: float
    held: float
    narrow_rise: float


class Plateau(Record, frozen=True):
    """Width of a tibial plateau on films, mean and standard deviation."""

    mean_mm: float
    sd_mm: float


class Thresholds(Record, frozen=True):
    """When a match is refused; each is derived by `pssf accuracy --tables localisation`.

    both       least mean of the wide and the narrow score
    side       greatest evidence for the other side than the one that is given, see `Located.side_evidence`
    doubtful   as `both` where the pitch is not known, unless the evidence for a side is
    sided      so much
    clear      as `both`, above which pixels are taken as square and knees as no severe ones
    many_looks as `both`, where pixels are taken as not square, or knees as severe
    stretched  by how much `both` must be better where pixels are not taken as square
    sure       as `both`, above which no other look is taken, whether a joint is refused or not
    way        evidence for upside down that is chance, see `Located.way_evidence`
    apart_mm   how far above or below the wide match the narrow one may be
    scale      of a knee over the standard one
    """

    both: float
    side: float
    doubtful: float
    sided: float
    clear: float
    many_looks: float
    stretched: float
    sure: float
    way: float
    apart_mm: float
    scale: Pair


class SidePattern(Record, frozen=True):
    """Weights of edges by which a right knee is told from a left one.

    block  pixels of the whole joint's patch, down and across, that one weight is for
    down, right  (rows, cols)  of edges by direction
    """

    block: int
    down: Rows
    right: Rows


class Localisation(Record, frozen=True):
    """Both tables."""

    wide: PatchLaw
    narrow: PatchLaw
    search: Search
    chance: Chance
    plateau: Plateau
    thresholds: Thresholds
    sides: SidePattern


@cache
def localisation() -> Localisation:
    """The package's tables of localisation."""
    return record(Localisation, data("localisation") | {"sides": data("side_pattern")}, "localisation")
