"""Load the radiomics tables: localisation settings and IBSI tags."""

from functools import cache

from ..data.analysis.ibsi_table import load_ibsi_tags
from ..data.analysis.localisation_table import LocalisationSettings, load_localisation_settings
from ..data.table_records import Record


class RadiomicsTables(Record, frozen=True):
    """Tables for localisation and feature measurement.

    Attributes
    ----------
    localisation : LocalisationSettings
        Search settings and rejection thresholds of the localisation.
    tags : dict of str to dict of str to str
        IBSI tag of each feature, keyed by family and then by feature name; see `load_ibsi_tags`.
    """

    localisation: LocalisationSettings
    tags: dict[str, dict[str, str]]


@cache
def radiomics_tables() -> RadiomicsTables:
    """Load the built-in radiomics tables.

    Returns
    -------
    RadiomicsTables
        Localisation settings and IBSI tags.
    """
    return RadiomicsTables(localisation=load_localisation_settings(), tags=load_ibsi_tags())
