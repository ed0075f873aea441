"""Cohort presets: number of knees, protocols, doses and repeats (``data/presets.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class CohortPreset(Record, frozen=True):
    """Definition of a simulated cohort.

    Attributes
    ----------
    knees : tuple of int
        Number of knees of each KL grade.
    bilateral : int
        Number of subjects with both knees in the cohort.
    protocols : tuple of str
        Names of the protocols.
    repeats : int
        Number of random training-test splits by subject.
    retested : int
        Number of knees that are imaged twice to estimate the reliability of features.
    acquisition : str
        "fixed" for nominal protocols; "sampled" for the acquisition variability that `sample_acquisition` simulates.
    grade_table : str
        Name of the grade table from which knees are sampled.
    doses : tuple of float
        Factors that multiply the mAs of a protocol. Each protocol is used with every combination of dose and tilt.
    tilts_deg : tuple of float
        Angles that are added to the beam angle of a protocol, in degrees.
    matrix : int
        Number of pixels along the longer side of the detector; 0 for the detector size of the protocol.
    settings : tuple of str
        Changes to knee and protocol fields, in the form "field=value".
    """

    knees: tuple[int, ...]
    bilateral: int
    protocols: tuple[str, ...]
    repeats: int
    retested: int
    acquisition: str = "fixed"
    grade_table: str = "population"
    doses: tuple[float, ...] = (1.0,)
    tilts_deg: tuple[float, ...] = (0.0,)
    matrix: int = 0
    settings: tuple[str, ...] = ()


@cache
def load_presets() -> dict[str, CohortPreset]:
    """Load all cohort presets in the package.

    Returns
    -------
    dict of str to CohortPreset
        Presets, keyed by name.
    """
    return parse_record(dict[str, CohortPreset], load_data_table("presets"), "presets")
