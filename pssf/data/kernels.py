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


class SmallField(Record, frozen=True):
    """Scatter by the kernel over that by the Monte Carlo, least and greatest, for fields up to so many mm."""

    side_mm: float
    low: float
    high: float


class ScatterKernel(Record, frozen=True):
    """All of `data/scatter.toml`; sums by projection."""

    reference_g_per_cm2: float
    reference_log: float
    reference_kv: float
    tube_kv: Pair
    most_mass: float
    logs: Pair
    full_field_mm: Pair
    small_fields: tuple[SmallField, ...]
    sums: tuple[TermSum, ...]

    def of(self, projection: str) -> TermSum:
        """The sum of a projection; the first for those that none was fitted for."""
        return next((one for one in self.sums if one.projection == projection), self.sums[0])

    def small_field(self, width_mm: float, height_mm: float) -> SmallField | None:
        """How far off the kernel is for a field on the detector that it was not fitted to; None for one that it was."""
        width, height = self.full_field_mm
        if width_mm >= width and height_mm >= height:
            return None
        return next(one for one in self.small_fields if min(width_mm, height_mm) <= one.side_mm)


@cache
def scatter_kernel() -> ScatterKernel:
    """The package's kernel."""
    return record(ScatterKernel, data("scatter"), "scatter")
