"""The constants of the scatter kernel, fitted to the Monte Carlo once more."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import structs
from scipy.optimize import least_squares

from ..core.checks import Array
from ..data.kernels import ScatterKernel, Term, TermSum, scatter_kernel
from ..data.tissues import Tissue, tissues
from ..model.protocol import Protocol
from ..scatter.kernel import Crossed, coarse, gaps_in_cells, shares
from .scatter import FITTED, FITTED_PA, SYMMETRIC, Case, measured

# Lower and upper bounds of a term's constants: without them powers drift that only cancel each other.
_BOUNDS = {
    "log_strength": (-12.0, 6.0), "per_10_kv": (-1.0, 1.0), "per_log": (-2.0, 2.0), "mass_power": (0.5, 4.0),
    "primary_power": (0.0, 2.5), "exit_power": (0.0, 1.5), "exit_mm": (5.0, 100.0), "inner_mm": (0.0, 300.0),
    "slope": (0.05, 4.0), "depth_mm": (0.0, 300.0),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Sample:
    """What the kernel starts from in one case, and what it should give: maps (rows, cols) over the open beam."""

    crossed: Crossed
    gaps_mm: Array
    protocol: Protocol
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
    cell_mm = step * run.technique.protocol.pixel_mm
    return Sample(
        crossed=Crossed(opened=opened / opened.max(), mass=mass, passed=passed, cell_mm=cell_mm),
        gaps_mm=gaps_in_cells(run.gaps_mm, mass.shape, step, run.technique.view),
        protocol=run.technique.protocol,
        expected=slow.mean(axis=0),
        error=slow.std(axis=0, ddof=1) / np.sqrt(len(slow)),
        slab=case[0] == "slab",
    )


def fitted_kernel(photons: int = 8_000_000, workers: int = 2) -> ScatterKernel:
    """Constants as in `data/scatter.toml`, by least squares from those that are there.

    Limbs and slabs, which are alike from both sides, count for both projections.
    """
    kernel, known = scatter_kernel(), tissues()
    for projection, cases in (("AP", FITTED), ("PA", (*FITTED_PA, *(case for case in FITTED if case[0] in SYMMETRIC)))):
        kernel = fit([sample_of(case, known, photons, workers) for case in cases], kernel, projection)
    return kernel


def fit(samples: Sequence[Sample], kernel: ScatterKernel, projection: str, rounds: int = 50) -> ScatterKernel:
    """The kernel with the constants of a projection fitted to samples.

    A residual is a relative difference in a cell over its error (2 % at least); cells outside the joint region weigh a
    quarter, the mean over the region as much as 12 cells, slabs 0.4 of limbs.
    """
    values = _values(kernel, projection)
    low, high = np.array([(-6.0, 3.0), *(list(_BOUNDS.values()) * len(kernel.of(projection).term))]).T
    turned = [replace(one, protocol=replace(one.protocol, projection=projection)) for one in samples]
    least = least_squares(
        lambda tried: _residuals(tried, turned, kernel, projection),
        np.clip(values, low + 1e-3, high - 1e-3),
        bounds=(low, high),
        x_scale="jac",
        max_nfev=rounds,
    )
    return _kernel(least.x, kernel, projection)


def cost(samples: Sequence[Sample], kernel: ScatterKernel, projection: str) -> float:
    """What `fit` makes least."""
    return float((_residuals(_values(kernel, projection), samples, kernel, projection) ** 2).sum())


def _values(kernel: ScatterKernel, projection: str) -> Array:
    fitted = kernel.of(projection)
    return np.array([fitted.inner_power, *(getattr(term, name) for term in fitted.term for name in _BOUNDS)])


def _kernel(values: Array, kernel: ScatterKernel, projection: str) -> ScatterKernel:
    rows = values[1:].reshape(-1, len(_BOUNDS))
    terms = tuple(Term(**dict(zip(_BOUNDS, map(float, row), strict=True))) for row in rows)
    new = TermSum(projection=projection, inner_power=float(values[0]), term=terms)
    return structs.replace(kernel, sums=tuple(new if one.projection == projection else one for one in kernel.sums))


def _residuals(values: Array, samples: Sequence[Sample], kernel: ScatterKernel, projection: str) -> Array:
    parts, tried = list[Array](), _kernel(values, kernel, projection)
    for sample in samples:
        rows, cols = sample.expected.shape
        region = np.s_[rows // 2 - 4 : rows // 2 + 4, cols // 2 - 3 : cols // 2 + 3]
        weight = np.full((rows, cols), 0.25)
        weight[region] = 1.0
        off = shares(sample.crossed, sample.gaps_mm, sample.protocol, tried) / sample.expected - 1
        sigma = np.maximum(sample.error / sample.expected / 0.02, 1.0)
        part = np.append(np.clip(off, -3, 3) * weight / sigma, 12 * _mean_off(off, sample.expected, region))
        parts.append(part * (0.4 if sample.slab else 1.0))
    terms = values[1:].reshape(-1, len(_BOUNDS))
    # A weak pull to constants of ordinary size.
    parts.append(0.03 * (terms[:, 1:6] - [0.0, 0.0, 1.3, 0.8, 0.4]).ravel())
    return np.concatenate(parts)


def _mean_off(off: Array, expected: Array, region: Any) -> float:
    return float((off[region] * expected[region]).sum() / expected[region].sum())
