"""Which feature of the Image Biomarker Standardisation Initiative a feature is, and where it departs from it."""

from ..files import tables


def tag_of(name: str) -> str:
    """The tag of the same feature in the initiative's table of reference values; "" for one that is not theirs.

    name  as `features.extract` gives it
    """
    family, short = _parts(name)
    return str(tables.data("ibsi").get(family, {}).get(short, ""))


def departure_of(name: str) -> str:
    """How a feature departs from the initiative's definition, or that it is not theirs; "" where it does not."""
    family, short = _parts(name)
    told = tables.data("ibsi")["departures"]
    return str(told.get(f"{family}_{short}", told.get(family, "")))


def _parts(name: str) -> tuple[str, str]:
    """Family and the feature's own name, without the image that it is of."""
    return name.split("_", 1)[0], name.rsplit("_", 1)[1]
