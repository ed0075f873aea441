"""IBSI tags: correspondence of features with those of the Image Biomarker Standardisation Initiative (IBSI)."""

from collections.abc import Mapping

from .feature_families import feature_family

IbsiTags = Mapping[str, Mapping[str, str]]


def find_ibsi_tag(name: str, tags: IbsiTags) -> str:
    """Find the tag of a feature in the reference values of the IBSI.

    Parameters
    ----------
    name : str
        Feature name from `extract_features`.
    tags : dict of str to dict of str to str
        Family to feature to its IBSI tag; see `load_ibsi_tags`.

    Returns
    -------
    str
        IBSI tag; empty if the IBSI does not define the feature.
    """
    return tags.get(feature_family(name), {}).get(_short_name(name), "")


def find_ibsi_departure(name: str, tags: IbsiTags) -> str:
    """Describe how a feature departs from the definition of the IBSI.

    Parameters
    ----------
    name : str
        Feature name from `extract_features`.
    tags : dict of str to dict of str to str
        Tables of the IBSI, with their entry "departures"; see `load_ibsi_tags`.

    Returns
    -------
    str
        Departure, or a remark that the IBSI does not define the feature; empty if there is no departure.
    """
    departures = tags["departures"]
    return departures.get(f"{feature_family(name)}_{_short_name(name)}", departures.get(feature_family(name), ""))


def _short_name(name: str) -> str:
    """Return the name of a feature without its family and image."""
    return name.rsplit("_", 1)[1]
