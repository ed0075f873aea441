"""Thresholds of OARSI and KL grades (``data/oarsi.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Pair,
    Record,
    Triple,
    parse_record,
)


class KellgrenLawrenceRule(Record, frozen=True):
    """Thresholds of the KL grade that is derived from an anatomy.

    Attributes
    ----------
    doubtful_mm : float
        Size above which an osteophyte is doubtful, in mm.
    definite_mm : float
        Size from which an osteophyte is definite, in mm.
    jsw_loss_fractions : (float, float)
        Fractions of the healthy joint space whose loss is definite (KL 3) and severe (KL 4).
    """

    doubtful_mm: float
    definite_mm: float
    jsw_loss_fractions: Pair


class OarsiThresholds(Record, frozen=True):
    """Lowest values of OARSI grades 1, 2 and 3, and healthy joint spaces.

    Attributes
    ----------
    osteophyte_mm : (float, float, float)
        Size of an osteophyte, in mm.
    narrowing : (float, float, float)
        Fraction of the healthy joint space that is lost.
    healthy_mm : dict of str to (float, float)
        Definition of the joint space width -> healthy medial and lateral width, in mm, mean of both sexes.
    male_excess_mm : dict of str to float
        Definition of the joint space width -> width of men minus that of women, in mm.
    plate : (float, float, float)
        Thickness of the tibial subchondral bone plate relative to a healthy one.
    attrition_mm : (float, float, float)
        Largest depth worn off a compartment of the plateau, in mm.
    kellgren_lawrence : KellgrenLawrenceRule
        Thresholds of the derived KL grade.
    """

    osteophyte_mm: Triple
    narrowing: Triple
    healthy_mm: dict[str, Pair]
    male_excess_mm: dict[str, float]
    plate: Triple
    attrition_mm: Triple
    kellgren_lawrence: KellgrenLawrenceRule

    def healthy_jsw_mm(self, side: str, *, sex: str, jsw_definition: str) -> float:
        """Return the healthy joint space width of a compartment.

        Parameters
        ----------
        side : {"medial", "lateral"}
            Compartment.
        sex : {"male", "female"}
            Sex.
        jsw_definition : {"projected", "read"}
            How the width is measured, as in `Knee.jsw_definition`.

        Returns
        -------
        float
            Joint space width, in mm.
        """
        medial, lateral = self.healthy_mm[jsw_definition]
        more = self.male_excess_mm[jsw_definition] * (0.5 if sex == "male" else -0.5)
        return (medial if side == "medial" else lateral) + more


@cache
def load_oarsi_thresholds() -> OarsiThresholds:
    """Load the thresholds of OARSI and KL grades.

    Returns
    -------
    OarsiThresholds
        Content of ``data/oarsi.toml``.
    """
    return parse_record(OarsiThresholds, load_data_table("oarsi"), "oarsi")
