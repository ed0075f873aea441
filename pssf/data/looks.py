"""Looks: how a linear image is shown for eyes, as `data/looks.toml` has them."""

from functools import cache

from .records import Record, record
from .tables import data


class Processed(Record, frozen=True):
    """A flat panel's processing: multi-scale contrast, latitude, a curve to grey. Signals as natural logarithms.

    power, bound, core          of the amplification of details
    edge_gain, edge_mm          factor of the finest details, and from which size on there is none
    latitude_gain, latitude_mm  factor of the coarsest structures, and the size that is half way there
    dark, bright                quantiles of the limb that are shown black and white
    bend                        share of the greys over which the curve bends there
    open, shut                  shares of the brightest signal above which is air, below which the collimator
    """

    power: float
    bound: float
    core: float
    edge_gain: float
    edge_mm: float
    latitude_gain: float
    latitude_mm: float
    dark: float
    bright: float
    bend: float
    open: float
    shut: float


class Film(Record, frozen=True):
    """A screen and film: optical densities of base, of the darkest place and of the limb's median; slope of the curve.

    open, shut  as in `Processed`
    """

    base: float
    most: float
    slope: float
    middle: float
    open: float
    shut: float


class Law(Record, frozen=True):
    """Mean and standard deviation of what varies, and the values that it is held between."""

    mean: float
    sd: float
    low: float
    high: float


class LookSpread(Record, frozen=True):
    """How `Processed` varies from site to site; edge_gain as its natural logarithm, edge_mm is the same for all.

    A share of films is plain: hardly processed, with gains by laws of their own.
    """

    plain: float
    latitude_gain: Law
    edge_gain: Law
    plain_latitude_gain: Law
    plain_edge_gain: Law
    edge_mm: float
    dark: Law
    bright: Law
    bend: Law


class Looks(Record, frozen=True):
    """The looks of the package, and how the first varies."""

    processed: Processed
    film: Film
    spread: LookSpread


@cache
def looks() -> Looks:
    """The looks that the package has."""
    return record(Looks, data("looks"), "looks")
