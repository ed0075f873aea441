"""Which feature of the Image Biomarker Standardisation Initiative is which, as `data/ibsi.toml` has it."""

from functools import cache

from .records import record
from .tables import data


@cache
def ibsi_tags() -> dict[str, dict[str, str]]:
    """Family -> short name of a feature -> its tag in the initiative's table of reference values.

    Under "departures": <family>_<short name>, or a family -> how it departs from the initiative's definition.
    """
    return record(dict[str, dict[str, str]], data("ibsi"), "ibsi")
