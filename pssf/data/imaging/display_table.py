"""Display processing: parameters for converting linear pixels to an image for presentation (``data/looks.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class FlatPanelProcessing(Record, frozen=True):
    """Parameters of flat-panel display processing: multi-scale contrast, latitude and grey-level curve.

    The processing works on natural logarithms of the signal.

    Parameters
    ----------
    power : float
        Exponent of the detail amplification; 1 does not change details, and values below 1 amplify small details.
    bound : float
        Amplitude of details that do not change, in units of the natural logarithm of the signal.
    core : float
        Amplitude below which all details have the same gain because they are mostly noise, in units of the natural
        logarithm of the signal.
    edge_gain : float
        Gain of the finest details.
    edge_mm : float
        Size of details at and above which the edge gain is 1, in mm.
    latitude_gain : float
        Gain of the coarsest structures.
    latitude_mm : float
        Size of structures at which the latitude gain has half of its effect, in mm.
    dark : float
        Quantile of the limb pixels that is displayed as black, 0 to 1.
    bright : float
        Quantile of the limb pixels that is displayed as white, 0 to 1.
    bend : float
        Width of the smooth transition at each end of the linear grey-level curve, as a fraction of the grey scale.
    air_above_fraction : float
        Fraction of the maximum signal above which a pixel shows air.
    collimated_below_fraction : float
        Fraction of the maximum signal below which a pixel is behind the collimator.
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
        Maximum optical density.
    slope : float
        Slope parameter of the characteristic curve; larger values are steeper.
    middle : float
        Optical density at the median signal of the limb.
    air_above_fraction : float
        Fraction of the maximum signal above which a pixel shows air.
    collimated_below_fraction : float
        Fraction of the maximum signal below which a pixel is behind the collimator.
    """

    base: float
    max_density: float
    slope: float
    middle: float
    air_above_fraction: float
    collimated_below_fraction: float


class BoundedNormal(Record, frozen=True):
    """Normal distribution with bounds, to which samples are clipped.

    Attributes
    ----------
    mean : float
        Mean of the normal distribution.
    sd : float
        Standard deviation of the normal distribution.
    low : float
        Lower bound of the samples.
    high : float
        Upper bound of the samples.
    """

    mean: float
    sd: float
    low: float
    high: float


class ProcessingVariability(Record, frozen=True):
    """Variation of `FlatPanelProcessing` between radiology departments.

    Attributes
    ----------
    weakly_processed_fraction : float
        Fraction of radiographs with weak processing, for which the gains have separate distributions.
    latitude_gain : BoundedNormal
        Distribution of the latitude gain.
    edge_gain : BoundedNormal
        Distribution of the natural logarithm of the edge gain.
    plain_latitude_gain : BoundedNormal
        Distribution of the latitude gain in weak processing.
    plain_edge_gain : BoundedNormal
        Distribution of the natural logarithm of the edge gain in weak processing.
    edge_mm : float
        Value of `FlatPanelProcessing.edge_mm`, which does not vary, in mm.
    dark : BoundedNormal
        Distribution of the quantile that is displayed as black.
    bright : BoundedNormal
        Distribution of the quantile that is displayed as white.
    bend : BoundedNormal
        Distribution of the width of the transitions (`FlatPanelProcessing.bend`).
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
    """Display processing of the package, and its variation between radiology departments.

    Attributes
    ----------
    processed : FlatPanelProcessing
        Parameters of the processing "processed".
    film : ScreenFilm
        Parameters of the processing "film".
    spread : ProcessingVariability
        Variation of the processing "processed" between radiology departments.
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
