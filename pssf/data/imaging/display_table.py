"""Display processing: parameters that turn linear pixels into an image for presentation (``data/looks.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class FlatPanelProcessing(Record, frozen=True):
    """Parameters of the display processing of a flat panel: multi-scale contrast, latitude and a curve to grey.

    The processing works on natural logarithms of the signal.

    Parameters
    ----------
    power : float
        Exponent of the amplification of details; 1 leaves them as they are, less than 1 amplifies small ones.
    bound : float
        Size of a detail that is not changed, natural logarithm of the signal.
    core : float
        Size below which all details have the same gain, since they are mostly noise; natural logarithm of the signal.
    edge_gain : float
        Gain of the finest details.
    edge_mm : float
        Size of details from which the edge gain is 1, in mm.
    latitude_gain : float
        Gain of the coarsest structures.
    latitude_mm : float
        Size of structures that get half of the latitude gain, in mm.
    dark : float
        Quantile of the limb's pixels that is shown black, 0 to 1.
    bright : float
        Quantile of the limb's pixels that is shown white, 0 to 1.
    bend : float
        Width of the bend at either end of the linear curve, as a fraction of the grey scale.
    air_above_fraction : float
        Fraction of the brightest signal above which a pixel shows air.
    collimated_below_fraction : float
        Fraction of the brightest signal below which a pixel is behind the collimator.
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
    air_above_fraction: float
    collimated_below_fraction: float


class ScreenFilm(Record, frozen=True):
    """Parameters of a screen-film system.

    Parameters
    ----------
    base : float
        Optical density of the film base.
    max_density : float
        Optical density of the darkest part.
    slope : float
        Slope parameter of the characteristic curve; larger is steeper.
    middle : float
        Optical density at the median signal of the limb.
    air_above_fraction : float
        Fraction of the brightest signal above which a pixel shows air.
    collimated_below_fraction : float
        Fraction of the brightest signal below which a pixel is behind the collimator.
    """

    base: float
    max_density: float
    slope: float
    middle: float
    air_above_fraction: float
    collimated_below_fraction: float


class BoundedNormal(Record, frozen=True):
    """Normal distribution with bounds; samples beyond a bound are set to it.

    Attributes
    ----------
    mean : float
        Mean.
    sd : float
        Standard deviation.
    low : float
        Lower bound.
    high : float
        Upper bound.
    """

    mean: float
    sd: float
    low: float
    high: float


class ProcessingVariability(Record, frozen=True):
    """Variation of `FlatPanelProcessing` between sites.

    Attributes
    ----------
    weakly_processed_fraction : float
        Fraction of radiographs with weak processing, whose gains have distributions of their own.
    latitude_gain : BoundedNormal
        Distribution of the latitude gain.
    edge_gain : BoundedNormal
        Distribution of the natural logarithm of the edge gain.
    plain_latitude_gain : BoundedNormal
        Distribution of the latitude gain in weak processing.
    plain_edge_gain : BoundedNormal
        Distribution of the natural logarithm of the edge gain in weak processing.
    edge_mm : float
        `FlatPanelProcessing.edge_mm` at all sites, in mm.
    dark : BoundedNormal
        Distribution of the quantile that is shown black.
    bright : BoundedNormal
        Distribution of the quantile that is shown white.
    bend : BoundedNormal
        Distribution of the width of the bends.
    """

    weakly_processed_fraction: float
    latitude_gain: BoundedNormal
    edge_gain: BoundedNormal
    plain_latitude_gain: BoundedNormal
    plain_edge_gain: BoundedNormal
    edge_mm: float
    dark: BoundedNormal
    bright: BoundedNormal
    bend: BoundedNormal


class DisplayProcessing(Record, frozen=True):
    """Display processing of the package, and its variation between sites.

    Attributes
    ----------
    processed : FlatPanelProcessing
        Parameters of the processing "processed".
    film : ScreenFilm
        Parameters of the processing "film".
    spread : ProcessingVariability
        Variation of "processed" between sites.
    """

    processed: FlatPanelProcessing
    film: ScreenFilm
    spread: ProcessingVariability


@cache
def load_display_processing() -> DisplayProcessing:
    """Load the display processing of the package.

    Returns
    -------
    DisplayProcessing
        Content of ``data/looks.toml``.
    """
    return parse_record(DisplayProcessing, load_data_table("looks"), "looks")
