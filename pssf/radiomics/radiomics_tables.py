"""Radiomics tables: settings of the localisation and IBSI tags, read together when a measurement begins."""

from functools import cache

from ..data.analysis.ibsi_table import load_ibsi_tags
from ..data.analysis.localisation_table import LocalisationSettings, load_localisation_settings
from ..data.table_records import Record


class RadiomicsTables(Record, frozen=True):
    """Tables that localisation and measurement need.

    Attributes
    ----------
    localisation : LocalisationSettings
        Search settings, and thresholds below which a match is rejected.
    tags : dict of str to dict of str to str
        Family to feature to its IBSI tag; see `load_ibsi_tags`.
    """

    localisation: LocalisationSettings
    tags: dict[str, dict[str, str]]


@cache
def radiomics_tables() -> RadiomicsTables:
    """Load the radiomics tables of the package.

    Returns
    -------
    RadiomicsTables
        Settings and tags.
    """
    return RadiomicsTables(localisation=load_localisation_settings(), tags=load_ibsi_tags())
