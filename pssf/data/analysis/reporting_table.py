"""Reporting guidelines: checklist items, and conditions on study files that answer them (``data/reporting.toml``)."""

from functools import cache

import msgspec

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class ChecklistItem(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One item of a reporting guideline.

    Attributes
    ----------
    id : str
        Identifier of the item in the guideline.
    item : str
        Information that the item requires.
    status : {"yes", "no", "human", "none"}
        "yes" if the evidence answers the item, "no" if the study does not fulfil it, "human" if an author must answer
        it, "none" if the item does not apply.
    evidence : str
        Conditions on study files (`io.file_conditions`), or the reason for the status.
    weight : float
        Weight in the METRICS score.
    """

    id: str
    item: str
    status: str
    evidence: str
    weight: float = 0.0


class Guideline(Record, frozen=True):
    """Reporting guideline with its checklist.

    Attributes
    ----------
    version : str
        Name and version of the guideline.
    items : tuple of ChecklistItem
        Checklist of the guideline.
    """

    version: str
    items: tuple[ChecklistItem, ...]


@cache
def load_reporting_guidelines() -> dict[str, Guideline]:
    """Load all reporting guidelines.

    Returns
    -------
    dict of str to Guideline
        Reporting guidelines, keyed by name.
    """
    return parse_record(dict[str, Guideline], load_data_table("reporting"), "reporting")
