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


class DatasetTable(Record, frozen=True):
    """Content of ``data/dataset.toml``.

    Attributes
    ----------
    grades : GradeFrequencies
        Frequencies of the KL grades.
    label_map : dict of str to int
        Value of each kind of part in the label map, in the order in which the parts are drawn.
    """

    grades: GradeFrequencies
    label_map: dict[str, int]


@cache
def load_dataset_table() -> DatasetTable:
    """Load the data set definitions of the package.

    Returns
    -------
    DatasetTable
        Content of ``data/dataset.toml``.
    """
    return parse_record(DatasetTable, load_data_table("dataset"), "dataset")
