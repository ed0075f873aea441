"""RadiomicsTables: what a region is looked for and measured by, read together where measuring begins."""

from functools import cache

from ..data.ibsi import ibsi_tags
from ..data.localisation import Localisation, localisation
from ..data.records import Record


class RadiomicsTables(Record, frozen=True):
    """What measuring a radiograph reads.

    localisation  how the joint is looked for and when it is refused
    tags          of `ibsi_tags`
    """

    localisation: Localisation
    tags: dict[str, dict[str, str]]


@cache
def radiomics_tables() -> RadiomicsTables:
    """The package's tables."""
    return RadiomicsTables(localisation=localisation(), tags=ibsi_tags())
