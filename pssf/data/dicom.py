"""What is the same in every DICOM object, and the codes in use, as `data/dicom.toml` has them."""

from functools import cache
from typing import Any

from .records import Record, record
from .tables import data

Code = tuple[str, str, str]
Attributes = dict[str, Any]


class DicomTables(Record, frozen=True):
    """Keyword -> value of a kind of object, and name -> scheme, value and meaning of a code."""

    every: Attributes
    radiograph: Attributes
    tube: Attributes
    processing: Attributes
    presentation: Attributes
    knee: Attributes
    segmentation: Attributes
    codes: dict[str, Code]


@cache
def dicom_tables() -> DicomTables:
    """The package's constants."""
    return record(DicomTables, data("dicom"), "dicom")
