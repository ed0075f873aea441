"""Feature tags of the Image Biomarker Standardisation Initiative (IBSI) reference manual."""

from collections.abc import Mapping

from .feature_families import feature_family, split_area

IbsiTags = Mapping[str, Mapping[str, str]]


def find_ibsi_tag(name: str, tags: IbsiTags) -> str:
    """Find the IBSI tag of a feature.

    Parameters
    ----------
    name : str
        Feature name from `extract_features`.
    tags : dict of str to dict of str to str
        IBSI tag of each feature, keyed by family and then by feature name; see `load_ibsi_tags`.

    Returns
    -------
    str
        IBSI tag; empty if the IBSI does not define the feature.
    """
    return tags.get(feature_family(name), {}).get(_short_name(name), "")


def find_ibsi_departure(name: str, tags: IbsiTags) -> str:
    """Describe the difference between a feature and its IBSI definition.

    Parameters
    ----------
    name : str
        Feature name from `extract_features`.
    tags : dict of str to dict of str to str
        IBSI tables with the entry "departures"; see `load_ibsi_tags`.

    Returns
    -------
    str
        Difference from the IBSI definition, or a note that the IBSI does not define the feature; empty if the feature
        agrees with the IBSI.
    """
    departures = tags["departures"]
    return departures.get(f"{feature_family(name)}_{_short_name(name)}", departures.get(feature_family(name), ""))


def _short_name(name: str) -> str:
    """Return a feature name without its family, image prefix and area."""
    return split_area(name)[0].rsplit("_", 1)[1]
