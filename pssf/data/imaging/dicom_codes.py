"""DICOM attributes that are the same in every object, and coded terms (``data/dicom.toml``)."""

from functools import cache
from typing import Any

from ..data_files import load_data_table
from ..table_records import Record, parse_record

Code = tuple[str, str, str]
Attributes = dict[str, Any]


class DicomTables(Record, frozen=True):
    """Constant DICOM attributes by kind of object, and coded terms.

    Attributes
    ----------
    every : dict of str to Any
        Keyword -> value, in every object.
    radiograph : dict of str to Any
        Keyword -> value, in every radiograph.
    tube : dict of str to Any
        Keyword -> value, in radiographs made with the spectrum of a tube.
    processing : dict of str to Any
        Keyword -> value, in radiographs with linear pixels ("for processing").
    presentation : dict of str to Any
        Keyword -> value, in radiographs after display processing ("for presentation").
    knee : dict of str to Any
        Keyword -> value, in radiographs of a knee.
    segmentation : dict of str to Any
        Keyword -> value, in segmentations.
    codes : dict of str to (str, str, str)
        Name -> coding scheme, code value and code meaning.
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
