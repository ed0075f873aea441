"""Data set definitions: frequencies of the KL grades and values of the label map (``data/dataset.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Numbers, Record, parse_record


class GradeFrequencies(Record, frozen=True):
    """Frequencies of the Kellgren-Lawrence grades.

    Attributes
    ----------
    prevalence : tuple of float
        Number of knees with each grade, starting with grade 0.
    """

    prevalence: Numbers


class EquipmentValues(Record, frozen=True):
    """Values from which the X-ray equipment of an image is sampled.

    Attributes
    ----------
    focal_spot_mm : tuple of float
        Sizes of the focal spot, in mm.
    filtration_mm_al : tuple of float
        Filtrations, in mm Al.
    grid_ratio : tuple of float
        Grid ratios.
    grid_lines_per_cm : tuple of float
        Strip densities of the grid, in 1/cm.
    """

    focal_spot_mm: Numbers
    filtration_mm_al: Numbers
    grid_ratio: Numbers
    grid_lines_per_cm: Numbers


class DatasetTable(Record, frozen=True):
    """Content of ``data/dataset.toml``.

    Attributes
    ----------
    grades : GradeFrequencies
        Frequencies of the KL grades.
    label_map : dict of str to int
        Value of each kind of part in the label map, in the order in which the parts are drawn.
    equipment : EquipmentValues
        Values from which the X-ray equipment is sampled.
    """

    grades: GradeFrequencies
    label_map: dict[str, int]
    equipment: EquipmentValues


@cache
def load_dataset_table() -> DatasetTable:
    """Load the data set definitions of the package.

    Returns
    -------
    DatasetTable
        Content of ``data/dataset.toml``.
    """
    return parse_record(DatasetTable, load_data_table("dataset"), "dataset")
