"""Reference values, published or computed with other software (``data/reference.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Numbers,
    Pair,
    Record,
    parse_record,
)


class ReferenceValue(Record, frozen=True):
    """Reference value or range of a quantity, with its source.

    Attributes
    ----------
    source : str
        Publication or software that provides the value.
    value : float or None
        Value in the unit of the quantity; None if the source provides a range.
    range : (float, float) or None
        Range of usual values; None if the source provides a single value.
    """

    source: str
    value: float | None = None
    range: Pair | None = None


class ReferenceSize(Record, frozen=True):
    """Mean and SD of an anatomical size, in mm or degrees.

    Attributes
    ----------
    source : str
        Publication or software that provides the value.
    patient_width_ratio : float or None
        Ratio of the size to the width of the tibial plateau, measured with the same method on bones of patients.
    male : (float, float) or None
        Mean and SD for men.
    female : (float, float) or None
        Mean and SD for women.
    both : (float, float) or None
        Mean and SD for men and women together.
    """

    source: str
    patient_width_ratio: float | None = None
    male: Pair | None = None
    female: Pair | None = None
    both: Pair | None = None


class ScatterCases(Record, frozen=True):
    """Reference values of scatter behind a limb and behind slabs of water.

    Attributes
    ----------
    limb : tuple of (float, float, float, float, float)
        Rows of tube voltage (kV), thickness (mm), air gap (mm), and primary and scatter divided by the open-beam
        signal.
    slab : tuple of (float, float, float, float)
        Rows of tube voltage (kV), thickness (mm), air gap (mm), and scatter-to-primary ratio.
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
        Requirement that the radiograph must meet.
    """

    view: str
    requirement: str


class ReferenceTables(Record, frozen=True):
    """All reference values.

    Attributes
    ----------
    spectrum : dict of str to (float, float)
        Photons per mm2 and mAs at 1 m, and mean energy in keV, keyed by tube voltage in kV.
    attenuation : dict of str to (float, float)
        Attenuation coefficients at 40 and 60 keV in 1/cm, keyed by tissue.
    scatter : ScatterCases
        Scatter behind a limb and behind slabs of water.
    morphometry : dict of str to ReferenceSize
        Mean and SD of anatomical sizes, keyed by name.
    texture : dict of str to ReferenceValue
        Ranges of trabecular texture measures on patient radiographs, keyed by measure.
    quality : dict of str to ReferenceValue
        Reference values or ranges for `pssf quality`, keyed by quantity.
    views : dict of str to ReferenceValue
        Reference values or ranges for `pssf validate --tables views`, keyed by quantity.
    criteria : dict of str to PositioningCriterion
        Criteria for `pssf validate --tables criteria`, keyed by quantity.
    beam : dict of str to tuple of float
        First and second half-value layer (mm Al), mean energy (keV), and photons per mm2 and mAs and air kerma
        (uGy/mAs) at 1 m, keyed by "<kV>_<mm Al>".
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
