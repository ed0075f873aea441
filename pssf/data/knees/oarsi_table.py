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
    """Thresholds for deriving the KL grade from the anatomy of a knee.

    Attributes
    ----------
    doubtful_mm : float
        Size above which an osteophyte counts as doubtful, in mm.
    definite_mm : float
        Smallest size of a definite osteophyte, in mm.
    jsw_loss_fractions : (float, float)
        Thresholds of joint space loss for definite (KL 3) and severe (KL 4) narrowing, as fractions of the healthy
        joint space width.
    """

    doubtful_mm: float
    definite_mm: float
    jsw_loss_fractions: Pair


class OarsiThresholds(Record, frozen=True):
    """Lower thresholds of OARSI grades 1, 2 and 3, and healthy joint space widths.

    Attributes
    ----------
    osteophyte_mm : (float, float, float)
        Thresholds of osteophyte size, in mm.
    narrowing : (float, float, float)
        Thresholds of joint space loss, as fractions of the healthy joint space width.
    healthy_mm : dict of str to (float, float)
        Healthy medial and lateral joint space width, in mm, averaged over both sexes and keyed by the JSW definition
        (``"projected"`` or ``"read"``).
    male_excess_mm : dict of str to float
        Mean joint space width of men minus the mean of women, in mm, keyed by the JSW definition (``"projected"`` or
        ``"read"``).
    plate : (float, float, float)
        Thresholds of the thickness of the tibial subchondral bone plate, relative to a healthy plate.
    attrition_mm : (float, float, float)
        Thresholds of the maximum attrition depth in a compartment of the tibial plateau, in mm.
    kellgren_lawrence : KellgrenLawrenceRule
        Thresholds for the derived KL grade.
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
            Definition of the joint space width, as in `Knee.jsw_definition`.

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
