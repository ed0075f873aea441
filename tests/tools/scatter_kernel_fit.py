"""Fit of the constants of the scatter kernel to the Monte Carlo simulation.

Run ``python -m tools.scatter_kernel_fit`` in the folder ``tests``; the command prints the fitted constants for
``pssf/data/scatter.toml``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import structs
from scipy.optimize import least_squares

from pssf.core.checks import Array
from pssf.data.anatomy.tissue_table import Tissue, load_tissues
from pssf.data.imaging.scatter_table import (
    ProjectionKernel,
    ScatterKernel,
    ScatterTerm,
    load_scatter_kernel,
)
from pssf.model.protocol import Protocol
from pssf.scatter.scatter_kernel import (
    KernelInput,
    coarsen_kernel_input,
    compute_scatter_fraction,
    interpolate_air_gaps_mm,
)
from pssf.validation.imaging.scatter_phantoms import (
    FIT_CASES,
    FIT_CASES_PA,
    SYMMETRIC,
    ScatterCase,
    run_monte_carlo,
)

# Lower and upper bound of each constant of a kernel term. Without bounds, terms with large powers cancel each other.
_BOUNDS = {
    "log_strength": (-12.0, 6.0), "per_10_kv": (-1.0, 1.0), "per_log": (-2.0, 2.0), "mass_power": (0.5, 4.0),
    "primary_power": (0.0, 2.5), "exit_power": (0.0, 1.5), "exit_mm": (5.0, 100.0), "inner_mm": (0.0, 300.0),
    "slope": (0.05, 4.0), "depth_mm": (0.0, 300.0),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class KernelSample:
    """Input of the scatter kernel for one case, and Monte Carlo scatter to which the kernel is fitted.

    Attributes
    ----------
    kernel_input : KernelInput
        Input maps of the kernel.
    gaps_mm : (rows, cols) array
        Air gap behind the object, in mm.
    protocol : Protocol
        Protocol of the case.
    expected_scatter : (rows, cols) array
        Monte Carlo scatter relative to the open beam, dimensionless.
    scatter_sd : (rows, cols) array
        Standard error of `expected_scatter`, dimensionless.
    is_slab : bool
        True if the object is a slab.
    """

    kernel_input: KernelInput
    gaps_mm: Array
    protocol: Protocol
    expected_scatter: Array
    scatter_sd: Array
    is_slab: bool


def make_kernel_sample(
    case: ScatterCase, known_tissues: Mapping[str, Tissue], photons: int, workers: int = 2
) -> KernelSample:
    """Simulate one case with the Monte Carlo code and prepare the input of the scatter kernel.

    Parameters
    ----------
    case : tuple of (str, float, float, float)
        Object, tube voltage in kV, thickness in mm and air gap in mm.
    known_tissues : mapping of str to Tissue
        Tissues by name.
    photons : int
        Number of photons.
    workers : int, default 2
        Number of worker processes.

    Returns
    -------
    KernelSample
        Kernel input and Monte Carlo scatter.
    """
    run = run_monte_carlo(case, known_tissues, photons, workers)
    opened, mass, passed, step = coarsen_kernel_input(run.primary, run.path_mm, run.technique)
    slow = run.counts.scatter_kev / run.counts.pixels / opened.max()
    cell_mm = step * run.technique.protocol.pixel_mm
    return KernelSample(
        kernel_input=KernelInput(
            open_beam=opened / opened.max(), mass_g_per_cm2=mass, transmission=passed, cell_mm=cell_mm
        ),
        gaps_mm=interpolate_air_gaps_mm(run.gaps_mm, mass.shape, step, run.technique.view),
        protocol=run.technique.protocol,
        expected_scatter=slow.mean(axis=0),
        scatter_sd=slow.std(axis=0, ddof=1) / np.sqrt(len(slow)),
        is_slab=case[0] == "slab",
    )


def fit_scatter_kernel(photons: int = 8_000_000, workers: int = 2) -> ScatterKernel:
    """Fit the constants of the scatter kernel by least squares, starting from the values in ``data/scatter.toml``.

    Limbs and slabs have mirror-symmetric anterior and posterior halves, so they are used for both projections.

    Parameters
    ----------
    photons : int, default 8_000_000
        Number of photons per case.
    workers : int, default 2
        Number of worker processes.

    Returns
    -------
    ScatterKernel
        Kernel with fitted constants.
    """
    kernel, known = load_scatter_kernel(), load_tissues()
    for projection, cases in (
        ("AP", FIT_CASES),
        ("PA", (*FIT_CASES_PA, *(case for case in FIT_CASES if case[0] in SYMMETRIC))),
    ):
        kernel = fit_projection(
            [make_kernel_sample(case, known, photons, workers) for case in cases], kernel, projection
        )
    return kernel


def fit_projection(
    samples: Sequence[KernelSample], kernel: ScatterKernel, projection: str, max_evaluations: int = 50
) -> ScatterKernel:
    """Fit the kernel constants of one projection to Monte Carlo samples.

    Parameters
    ----------
    samples : sequence of KernelSample
        Samples to which the constants are fitted.
    kernel : ScatterKernel
        Kernel with the initial constants.
    projection : str
        Projection, ``"AP"`` or ``"PA"``.
    max_evaluations : int, default 50
        Maximum number of function evaluations.

    Returns
    -------
    ScatterKernel
        Kernel with fitted constants for `projection`.

    Notes
    -----
    A residual is the relative difference in a cell, reduced if its standard error exceeds 2 %. Residuals of cells
    outside the joint region are multiplied by 0.25. The mean relative difference over the region is multiplied by 12.
    Residuals of slabs are multiplied by 0.4.
    """
    values = _pack_constants(kernel, projection)
    low, high = np.array([(-6.0, 3.0), *(list(_BOUNDS.values()) * len(kernel.for_projection(projection).term))]).T
    turned = [replace(one, protocol=replace(one.protocol, projection=projection)) for one in samples]
    least = least_squares(
        lambda tried: _compute_residuals(tried, turned, kernel, projection),
        np.clip(values, low + 1e-3, high - 1e-3),
        bounds=(low, high),
        x_scale="jac",
        max_nfev=max_evaluations,
    )
    return _unpack_constants(least.x, kernel, projection)


def compute_fit_cost(samples: Sequence[KernelSample], kernel: ScatterKernel, projection: str) -> float:
    """Compute the sum of squared residuals that :func:`fit_projection` minimises.

    Parameters
    ----------
    samples : sequence of KernelSample
        Samples with which the kernel is compared.
    kernel : ScatterKernel
        Kernel to evaluate.
    projection : str
        Projection, ``"AP"`` or ``"PA"``.

    Returns
    -------
    float
        Sum of squared residuals.
    """
    return float((_compute_residuals(_pack_constants(kernel, projection), samples, kernel, projection) ** 2).sum())


def _pack_constants(kernel: ScatterKernel, projection: str) -> Array:
    """Pack the constants of one projection into a vector."""
    fitted = kernel.for_projection(projection)
    return np.array([fitted.inner_power, *(getattr(term, name) for term in fitted.term for name in _BOUNDS)])


def _unpack_constants(values: Array, kernel: ScatterKernel, projection: str) -> ScatterKernel:
    """Replace the constants of one projection by the values of a vector."""
    rows = values[1:].reshape(-1, len(_BOUNDS))
    terms = tuple(ScatterTerm(**dict(zip(_BOUNDS, map(float, row), strict=True))) for row in rows)
    new = ProjectionKernel(projection=projection, inner_power=float(values[0]), term=terms)
    return structs.replace(kernel, sums=tuple(new if one.projection == projection else one for one in kernel.sums))


def _compute_residuals(values: Array, samples: Sequence[KernelSample], kernel: ScatterKernel, projection: str) -> Array:
    """Compute the weighted residuals of all samples, with a weak penalty on the constants."""
    parts, tried = list[Array](), _unpack_constants(values, kernel, projection)
    for sample in samples:
        rows, cols = sample.expected_scatter.shape
        region = np.s_[rows // 2 - 4 : rows // 2 + 4, cols // 2 - 3 : cols // 2 + 3]
        weight = np.full((rows, cols), 0.25)
        weight[region] = 1.0
        off = (
            compute_scatter_fraction(sample.kernel_input, sample.gaps_mm, sample.protocol, tried)
            / sample.expected_scatter
            - 1
        )
        sigma = np.maximum(sample.scatter_sd / sample.expected_scatter / 0.02, 1.0)
        part = np.append(
            np.clip(off, -3, 3) * weight / sigma, 12 * _mean_relative_error(off, sample.expected_scatter, region)
        )
        parts.append(part * (0.4 if sample.is_slab else 1.0))
    terms = values[1:].reshape(-1, len(_BOUNDS))
    # The penalty keeps the constants close to typical values.
    parts.append(0.03 * (terms[:, 1:6] - [0.0, 0.0, 1.3, 0.8, 0.4]).ravel())
    return np.concatenate(parts)


def _mean_relative_error(off: Array, expected: Array, region: Any) -> float:
    """Average the relative error over a region, weighted by the expected scatter."""
    return float((off[region] * expected[region]).sum() / expected[region].sum())


if __name__ == "__main__":
    print(structs.asdict(fit_scatter_kernel()))
