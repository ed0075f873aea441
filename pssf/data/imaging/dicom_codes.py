"""DICOM attributes with constant values, and coded terms (``data/dicom.toml``)."""

from functools import cache
from typing import Any

from ..data_files import load_data_table
from ..table_records import Record, parse_record

Code = tuple[str, str, str]
Attributes = dict[str, Any]


class DicomTables(Record, frozen=True):
    """DICOM attributes with constant values for each type of object, and coded terms. Attributes are keyed by keyword.

    Attributes
    ----------
    every : dict of str to Any
        Attributes of every object.
    radiograph : dict of str to Any
        Attributes of every radiograph.
    tube : dict of str to Any
        Attributes of radiographs simulated with a tube spectrum.
    processing : dict of str to Any
        Attributes of radiographs with linear pixels ("for processing").
    presentation : dict of str to Any
        Attributes of radiographs after display processing ("for presentation").
    knee : dict of str to Any
        Attributes of radiographs of a knee.
    segmentation : dict of str to Any
        Attributes of segmentations.
    codes : dict of str to (str, str, str)
        Coding scheme, code value and code meaning of each term, keyed by name.
    """

    every: Attributes
    radiograph: Attributes
    tube: Attributes
    processing: Attributes
    presentation: Attributes
    knee: Attributes
    segmentation: Attributes
    codes: dict[str, Code]


@cache
def load_dicom_tables() -> DicomTables:
    """Load the DICOM attributes and codes.

    Returns
    -------
    DicomTables
        Content of ``data/dicom.toml``.
    """
    return parse_record(DicomTables, load_data_table("dicom"), "dicom")
