"""IBSI tags of radiomics features (Image Biomarker Standardisation Initiative, ``data/ibsi.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import parse_record


@cache
def load_ibsi_tags() -> dict[str, dict[str, str]]:
    """Load the IBSI tags of radiomics features.

    Returns
    -------
    dict of str to dict of str to str
        IBSI tag of each feature, keyed by family and then by feature name. The additional key "departures" contains the
        differences from IBSI definitions, keyed by family or by "<family>_<feature>".
    """
    return parse_record(dict[str, dict[str, str]], load_data_table("ibsi"), "ibsi")
