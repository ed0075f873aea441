"""ScatterKernel: constants of the kernel of scatter, as `data/scatter.toml` has them."""

from functools import cache

from .records import Pair, Record, record
from .tables import data


class Term(Record, frozen=True):
    """One term of the sum; its form is in the table."""

    log_strength: float
    per_10_kv: float
    per_log: float
    mass_power: float
    primary_power: float
    exit_power: float
    exit_mm: float
    inner_mm: float
    slope: float
    depth_mm: float


class TermSum(Record, frozen=True):
    """What scatter is the sum of, where rays go one way through a knee."""

    projection: str
    inner_power: float
    term: tuple[Term, ...]


class ScatterKernel(Record, frozen=True):
    """All of `data/scatter.toml`; sums by projection."""

    reference_g_per_cm2: float
    reference_log: float
    reference_kv: float
    tube_kv: Pair
    most_mass: float
    logs: Pair
    sums: tuple[TermSum, ...]

    def of(self, projection: str) -> TermSum:
        """The sum of a projection; the first for those that none was fitted for."""
        return next((one for one in self.sums if one.projection == projection), self.sums[0])


@cache
def scatter_kernel() -> ScatterKernel:
    """The package's kernel."""
    return record(ScatterKernel, data("scatter"), "scatter")
