"""Tags of features in the reference values of the Image Biomarker Standardisation Initiative (``data/ibsi.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import parse_record


@cache
def load_ibsi_tags() -> dict[str, dict[str, str]]:
    """Load the IBSI tags of radiomics features.

    Returns
    -------
    dict of str to dict of str to str
        Feature family -> feature name -> IBSI tag. The entry "departures" maps a family, or "<family>_<feature>", to
        its difference from the IBSI definition.
    """
    return parse_record(dict[str, dict[str, str]], load_data_table("ibsi"), "ibsi")
