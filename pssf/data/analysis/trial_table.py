"""Default design of a virtual trial (``data/trial.toml``), and the records of a design."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record


class TrialPopulation(Record, frozen=True):
    """Subjects of a trial.

    Attributes
    ----------
    grade_table : str
        Name or file of the grade table.
    grades : tuple of int
        KL grades at the first visit.
    shares : tuple of float
        Relative share of each grade.
    female : float
        Share of women, 0 to 1.
    bmi : (float, float)
        Smallest and largest body mass index, in kg/m2.
    knees : int
        Knees per subject, 1 or 2.
    """

    grade_table: str
    grades: tuple[int, ...]
    shares: tuple[float, ...]
    female: float
    bmi: Pair
    knees: int


class Treatment(Record, frozen=True):
    """Effect of the treatment.

    Attributes
    ----------
    fraction : float
        Fraction by which the loss of joint space is slowed, 0 to 1.
    compartment : {"medial", "lateral", "both"}
        Compartment in which it is slowed.
    treated : float
        Share of subjects in the treated arm, 0 to 1.
    """

    fraction: float
    compartment: str
    treated: float


class DropOut(Record, frozen=True):
    """Drop-out of subjects.

    Attributes
    ----------
    per_year : float
        Probability that a subject leaves the trial within a year, 0 to 0.9.
    """

    per_year: float


class HumanReader(Record, frozen=True):
    """Human reader, who measures the projected joint space with an error.

    Attributes
    ----------
    bias_mm : float
        Mean error, in mm.
    sd_mm : float
        Standard deviation of the error of one reading, in mm.
    """

    bias_mm: float
    sd_mm: float


class Site(Record, frozen=True):
    """Imaging site.

    Attributes
    ----------
    name : str
        Name of the site.
    share : float
        Relative share of subjects.
    positioning : float
        Factor of the standard deviations of positioning, 0 to 5; 0 is perfect positioning.
    beam_offset_deg : float
        Systematic error of the beam angle, in degrees.
    display : str
        Display processing: "sampled" (one processing for all images of the site), "processed", "log" or "film".
    detector : str
        Name or file of the detector; empty: that of the view.
    """

    name: str
    share: float
    positioning: float = 1.0
    beam_offset_deg: float = 0.0
    display: str = "processed"
    detector: str = ""


class TrialDesign(Record, frozen=True):
    """Design of a virtual trial.

    Attributes
    ----------
    subjects : int
        Number of subjects.
    visits_months : tuple of float
        Times of the visits, in months; the first is 0.
    views : tuple of str
        Names or files of the protocols.
    repeats : int
        Number of radiographs of each view at the first visit.
    cause_subjects : int
        Number of subjects whose repeated radiographs are simulated again without each cause of error.
    pixel_mm : float
        Pixel size on the detector, in mm; 0: as in the view.
    texture : bool
        Whether to measure the texture of the medial subchondral region.
    readers : tuple of str
        Readers, from "label", "network" and "human".
    population : TrialPopulation
        Subjects.
    treatment : Treatment
        Effect of the treatment.
    dropout : DropOut
        Drop-out.
    human : HumanReader
        Error of the human reader.
    sites : tuple of Site
        Imaging sites.
    seed : int
        Seed of all random numbers.
    """

    subjects: int
    visits_months: tuple[float, ...]
    views: tuple[str, ...]
    repeats: int
    cause_subjects: int
    pixel_mm: float
    texture: bool
    readers: tuple[str, ...]
    population: TrialPopulation
    treatment: Treatment
    dropout: DropOut
    human: HumanReader
    sites: tuple[Site, ...]
    seed: int = 0


@cache
def load_default_trial() -> TrialDesign:
    """Load the default design of a trial.

    Returns
    -------
    TrialDesign
        Default design.
    """
    return parse_record(TrialDesign, load_data_table("trial"), "trial")
