"""Acquisition variability: how positioning and technique vary between radiographs (``data/exposures.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record


class CollimatedField(Record, frozen=True):
    """Ranges of the sides of the collimated field on the detector.

    Attributes
    ----------
    width_mm : (float, float)
        Smallest and largest width, in mm.
    height_mm : (float, float)
        Smallest and largest height, in mm.
    """

    width_mm: Pair
    height_mm: Pair


class SideMarker(Record, frozen=True):
    """Frequency of a side marker of lead on the radiograph.

    Attributes
    ----------
    share : float
        Fraction of acquisitions with a marker, 0 to 1.
    """

    share: float


class AcquisitionVariability(Record, frozen=True):
    """Distributions that a protocol is varied by for each radiograph.

    Attributes
    ----------
    spread : dict of str to float
        Protocol field -> standard deviation about its nominal value, in the unit of the field.
    step : dict of str to float
        Protocol field -> step in which the console is set, in the unit of the field.
    factor : dict of str to float
        Protocol field -> standard deviation of the natural logarithm of its ratio to the nominal value.
    field : CollimatedField
        Ranges of the collimated field.
    marker : SideMarker
        Frequency of a side marker.
    """

    spread: dict[str, float]
    step: dict[str, float]
    factor: dict[str, float]
    field: CollimatedField
    marker: SideMarker


@cache
def load_acquisition_variability() -> AcquisitionVariability:
    """Load the acquisition variability of the package.

    Returns
    -------
    AcquisitionVariability
        Content of ``data/exposures.toml``.
    """
    return parse_record(AcquisitionVariability, load_data_table("exposures"), "exposures")
