"""Reference values: published, or computed with other software (``data/reference.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Numbers,
    Pair,
    Record,
    parse_record,
)


class ReferenceValue(Record, frozen=True):
    """A reference value or range, with its source.

    Attributes
    ----------
    source : str
        Source.
    value : float or None
        Value.
    range : (float, float) or None
        Range of usual values.
    """

    source: str
    value: float | None = None
    range: Pair | None = None


class ReferenceSize(Record, frozen=True):
    """Mean and SD of an anatomical size, in mm or degrees.

    Attributes
    ----------
    source : str
        Source.
    patient_width_ratio : float or None
        Ratio to the width of the tibial plateau, measured in the same way on bones of patients.
    male : (float, float) or None
        Mean and SD of men.
    female : (float, float) or None
        Mean and SD of women.
    both : (float, float) or None
        Mean and SD of men and women together.
    """

    source: str
    patient_width_ratio: float | None = None
    male: Pair | None = None
    female: Pair | None = None
    both: Pair | None = None


class ScatterCases(Record, frozen=True):
    """Cases of the scatter reference.

    Attributes
    ----------
    limb : tuple of (float, float, float, float, float)
        Rows of tube voltage (kV), thickness (mm), air gap (mm), primary and scatter over the open beam.
    slab : tuple of (float, float, float, float)
        Rows of tube voltage (kV), thickness (mm), air gap (mm), and scatter over primary.
    """

    limb: tuple[tuple[float, float, float, float, float], ...]
    slab: tuple[tuple[float, float, float, float], ...]


class PositioningCriterion(Record, frozen=True):
    """Criterion of correct positioning, from a positioning guide.

    Attributes
    ----------
    view : str
        Name of the protocol.
    requirement : str
        What the radiograph must show.
    """

    view: str
    requirement: str


class ReferenceTables(Record, frozen=True):
    """All reference values.

    Attributes
    ----------
    spectrum : dict of str to (float, float)
        Tube voltage in kV -> photons/mm2/mAs at 1 m, and mean energy in keV.
    attenuation : dict of str to (float, float)
        Tissue -> attenuation coefficient at 40 and 60 keV, in 1/cm.
    scatter : ScatterCases
        Scatter behind a limb and behind slabs of water.
    morphometry : dict of str to ReferenceSize
        Anatomical size -> mean and SD.
    texture : dict of str to ReferenceValue
        Measure of trabecular texture -> range on patient radiographs.
    quality : dict of str to ReferenceValue
        Quantity of `pssf quality` -> value or range.
    views : dict of str to ReferenceValue
        Quantity of `pssf validate --tables views` -> value or range.
    criteria : dict of str to PositioningCriterion
        Quantity of `pssf validate --tables criteria` -> criterion.
    beam : dict of str to tuple of float
        "<kV>_<mm Al>" -> first and second half-value layer (mm Al), mean energy (keV), photons/mm2/mAs, and air kerma
        (uGy/mAs) at 1 m.
    """

    spectrum: dict[str, Pair]
    attenuation: dict[str, Pair]
    scatter: ScatterCases
    morphometry: dict[str, ReferenceSize]
    texture: dict[str, ReferenceValue]
    quality: dict[str, ReferenceValue]
    views: dict[str, ReferenceValue]
    criteria: dict[str, PositioningCriterion]
    beam: dict[str, Numbers]


@cache
def load_reference_tables() -> ReferenceTables:
    """Load the reference values.

    Returns
    -------
    ReferenceTables
        Content of ``data/reference.toml``.
    """
    return parse_record(ReferenceTables, load_data_table("reference"), "reference")
