"""Load the tables and protocols on which the images of a data set depend."""

from dataclasses import dataclass, replace
from math import ceil

from ..core.checks import InputError, require_choice
from ..data.anatomy.tissue_table import load_tissues
from ..data.imaging.dataset_table import DatasetTable, load_dataset_table
from ..data.imaging.display_table import DisplayProcessing, load_display_processing
from ..data.knees.oarsi_table import OarsiThresholds, load_oarsi_thresholds
from ..model.protocol import Protocol, load_protocol
from ..model.sampling.knee_sampling import KneeDistributions, load_knee_distributions
from .dataset_settings import DatasetSettings


@dataclass(frozen=True, kw_only=True, eq=False)
class DatasetTables:
    """Tables and protocols of a data set.

    Attributes
    ----------
    definitions : DatasetTable
        Frequencies of the grades and values of the label map.
    distributions : KneeDistributions
        Distributions from which knees are sampled.
    display : DisplayProcessing
        Default display processing and distributions of its parameters.
    cuts : OarsiThresholds
        Thresholds of the grades of osteophytes and joint space narrowing.
    protocols : tuple of Protocol
        Protocols of the data set with the requested pixel size.
    """

    definitions: DatasetTable
    distributions: KneeDistributions
    display: DisplayProcessing
    cuts: OarsiThresholds
    protocols: tuple[Protocol, ...]


def load_dataset_tables(settings: DatasetSettings) -> DatasetTables:
    """Load the tables and protocols of a data set.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.

    Returns
    -------
    DatasetTables
        Tables and protocols.

    Raises
    ------
    InputError
        If a protocol, a material or the grade table is unknown, a protocol images two knees and `crop_mm` is 0, or the
        crop is larger than the detector.
    """
    for name in settings.maps:
        require_choice("maps", name, tuple(load_tissues()))
    return DatasetTables(
        definitions=load_dataset_table(),
        distributions=load_knee_distributions(settings.grade_table),
        display=load_display_processing(),
        cuts=load_oarsi_thresholds(),
        protocols=tuple(_fit_protocol(load_protocol(name), settings) for name in settings.protocols),
    )


def _fit_protocol(protocol: Protocol, settings: DatasetSettings) -> Protocol:
    """Change the pixel size of a protocol so that an image, or its crop, has the requested number of pixels."""
    if protocol.knee_distance_mm and not settings.crop_mm:
        raise InputError(
            f"crop_mm must be above 0 for the protocol {protocol.name}, got 0 mm: the protocol images two knees, and "
            "each crop shows one of them"
        )
    if not settings.crop_mm:
        return protocol.resample(settings.matrix) if settings.matrix else protocol
    height_mm, width_mm = (side * protocol.pixel_mm for side in (protocol.rows, protocol.cols))
    if settings.crop_mm > min(height_mm, width_mm):
        raise InputError(
            f"crop_mm must be at most {min(height_mm, width_mm):g} mm, the size of the detector of {protocol.name}, "
            f"got {settings.crop_mm:g} mm"
        )
    if not settings.matrix:
        return protocol
    pixel_mm = settings.crop_mm / settings.matrix
    rows, cols = (ceil(round(side / pixel_mm, 6)) for side in (height_mm, width_mm))
    return replace(protocol, rows=rows, cols=cols, pixel_mm=round(pixel_mm, 9))
