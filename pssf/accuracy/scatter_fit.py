"""The constants of the scatter kernel, fitted to the Monte Carlo once more."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import structs
from scipy.optimize import least_squares

from ..core.checks import Array
from ..data.kernels import ScatterKernel, Term, scatter_kernel
from ..data.tissues import Tissue, tissues
from ..scatter.kernel import Crossed, coarse, shares
from .scatter import FITTED, Case, measured

# Lower and upper bounds of a term's constants: without them powers drift that only cancel each other.
_BOUNDS = {
    "log_strength": (-12.0, 6.0), "per_10_kv": (-1.0, 1.0), "per_log": (-2.0, 2.0), "mass_power": (0.0, 4.0),
    "primary_power": (0.0, 2.5), "exit_power": (0.0, 1.5), "exit_mm": (5.0, 100.0), "inner_mm": (0.0, 300.0),
    "slope": (0.05, 4.0), "depth_mm": (0.0, 300.0),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Sample:
    """What the kernel starts from in one case, and what it should give: maps (rows, cols) over the open beam."""

    crossed: Crossed
    gap_mm: float
    tube_kv: float
    expected: Array
    error: Array
    slab: bool


def sample_of(case: Case, known: Mapping[str, Tissue], photons: int, workers: int = 2) -> Sample:
    """One case by Monte Carlo.

    known  tissues by name
    """
    run = measured(case, known, photons, workers)
    opened, mass, passed, step = coarse(run.primary, run.path_mm, run.technique)
    slow = run.counts.scatter_kev / run.counts.pixels / opened.max()
    protocol = run.technique.protocol
    cell_mm = step * protocol.pixel_mm
    return Sample(
        crossed=Crossed(opened=opened / opened.max(), mass=mass, passed=passed, cell_mm=cell_mm),
        gap_mm=run.gap_mm,
        tube_kv=protocol.tube_kv,
        expected=slow.mean(axis=0),
        error=slow.std(axis=0, ddof=1) / np.sqrt(len(slow)),
        slab=case[0] == "slab",
    )


def fitted_kernel(
    photons: int = 16_000_000, workers: int = 2, cases: tuple[Case, ...] = FITTED, rounds: int = 35
) -> ScatterKernel:
    """Constants as in `data/scatter.toml`, by least squares from those that are there.

    A residual is a relative difference in a cell over its error (2 % at least); cells outside the joint region weigh a
    quarter, the mean over the region as much as 12 cells, slabs 0.4 of limbs.
    """
    kernel, known = scatter_kernel(), tissues()
    samples = [sample_of(case, known, photons, workers) for case in cases]
    start = np.array([kernel.inner_power, *(getattr(term, name) for term in kernel.term for name in _BOUNDS)])
    low, high = np.array([(-6.0, 3.0), *(list(_BOUNDS.values()) * len(kernel.term))]).T
    inside = np.clip(start, low + 1e-3, high - 1e-3)
    how = {"bounds": (low, high), "x_scale": "jac", "max_nfev": rounds}
    fit = least_squares(_residuals, inside, **how, args=(samples, kernel))
    return _kernel(fit.x, kernel)


def _kernel(values: Array, kernel: ScatterKernel) -> ScatterKernel:
    rows = values[1:].reshape(-1, len(_BOUNDS))
    terms = tuple(Term(**dict(zip(_BOUNDS, map(float, row), strict=True))) for row in rows)
    return structs.replace(kernel, inner_power=float(values[0]), term=terms)


def _residuals(values: Array, samples: list[Sample], kernel: ScatterKernel) -> Array:
    parts, tried = list[Array](), _kernel(values, kernel)
    for sample in samples:
        rows, cols = sample.expected.shape
        region = np.s_[rows // 2 - 4 : rows // 2 + 4, cols // 2 - 3 : cols // 2 + 3]
        weight = np.full((rows, cols), 0.25)
        weight[region] = 1.0
        off = shares(sample.crossed, sample.gap_mm, sample.tube_kv, tried) / sample.expected - 1
        sigma = np.maximum(sample.error / sample.expected / 0.02, 1.0)
        part = np.append(np.clip(off, -3, 3) * weight / sigma, 12 * _mean_off(off, sample.expected, region))
        parts.append(part * (0.4 if sample.slab else 1.0))
    terms = values[1:].reshape(-1, len(_BOUNDS))
    # A weak pull to constants of ordinary size.
    parts.append(0.03 * (terms[:, 1:6] - [0.0, 0.0, 1.3, 0.8, 0.4]).ravel())
    return np.concatenate(parts)


def _mean_off(off: Array, expected: Array, region: Any) -> float:
    return float((off[region] * expected[region]).sum() / expected[region].sum())
