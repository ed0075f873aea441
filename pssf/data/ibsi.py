"""IbsiTags: which feature of the Image Biomarker Standardisation Initiative is which, as `data/ibsi.toml` has it."""

from functools import cache

from .records import Record, record
from .tables import data


class IbsiTags(Record, frozen=True):
    """Family -> short name of a feature -> its tag in the initiative's table of reference values.

    departures  <family>_<short name>, or a family -> how it departs from the initiative's definition
    """

    firstorder: dict[str, str]
    glcm: dict[str, str]
    glrlm: dict[str, str]
    glszm: dict[str, str]
    ngtdm: dict[str, str]
    gldm: dict[str, str]
    departures: dict[str, str]


@cache
def ibsi_tags() -> IbsiTags:
    """The package's table of tags."""
    return record(IbsiTags, data("ibsi"), "ibsi")
