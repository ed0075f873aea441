"""Which feature of the Image Biomarker Standardisation Initiative a feature is, and where it departs from it."""

from collections.abc import Mapping

from .families import family

Tags = Mapping[str, Mapping[str, str]]


def tag_of(name: str, tags: Tags) -> str:
    """The tag of the same feature in the initiative's table of reference values; "" for one that is not theirs.

    name  as `features.extract` gives it
    tags  of `data.ibsi.ibsi_tags`
    """
    return tags.get(family(name), {}).get(_short(name), "")


def departure_of(name: str, tags: Tags) -> str:
    """How a feature departs from the initiative's definition, or that it is not theirs; "" where it does not."""
    departures = tags["departures"]
    return departures.get(f"{family(name)}_{_short(name)}", departures.get(family(name), ""))


def _short(name: str) -> str:
    """The feature's own name, without family and the image that it is of."""
    return name.rsplit("_", 1)[1]
