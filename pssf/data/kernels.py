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


class ScatterKernel(Record, frozen=True):
    """All of `data/scatter.toml`."""

    reference_g_per_cm2: float
    reference_log: float
    reference_kv: float
    tube_kv: Pair
    most_mass: float
    logs: Pair
    inner_power: float
    term: tuple[Term, ...]


@cache
def scatter_kernel() -> ScatterKernel:
    """The package's kernel."""
    return record(ScatterKernel, data("scatter"), "scatter")
