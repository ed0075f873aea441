"""OarsiCuts: from which value on a feature has OARSI grade 1, 2 and 3, as `data/oarsi.toml` has it."""

from functools import cache

from .records import Pair, Record, Triple, record
from .tables import data


class KellgrenLawrence(Record, frozen=True):
    """Rule that derives a KL grade.

    doubtful_mm  size above which an osteophyte is doubtful, and
    definite_mm  size from which an osteophyte is definite
    lost         fractions of a healthy joint space whose loss is definite (KL 3) and severe (KL 4)
    """

    doubtful_mm: float
    definite_mm: float
    lost: Pair


class OarsiCuts(Record, frozen=True):
    """All of `data/oarsi.toml`.

    healthy_mm   of each way to measure, the medial and the lateral space, of a half of men and a half of women
    men_more_mm  of each way, what men have more than women
    """

    osteophyte_mm: Triple
    narrowing: Triple
    healthy_mm: dict[str, Pair]
    men_more_mm: dict[str, float]
    plate: Triple
    attrition_mm: Triple
    kellgren_lawrence: KellgrenLawrence

    def healthy(self, side: str, *, sex: str, jsw_as: str) -> float:
        """A healthy joint space, mm, by the measure that `Knee.jsw_as` names."""
        medial, lateral = self.healthy_mm[jsw_as]
        more = self.men_more_mm[jsw_as] * (0.5 if sex == "male" else -0.5)
        return (medial if side == "medial" else lateral) + more


@cache
def oarsi_cuts() -> OarsiCuts:
    """The package's table."""
    return record(OarsiCuts, data("oarsi"), "oarsi")
