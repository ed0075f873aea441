"""Comparison of the Monte Carlo scatter code with independent code, for water slabs and elliptical limbs."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...core.resample import downsample_by_blocks
from ...data.analysis.reference_table import load_reference_tables
from ...data.anatomy.tissue_table import Tissue, load_tissues
from ...model.protocol import load_protocol
from ...raycast import trace
from ...scatter.detector_correction import use_fitted_detector
from ...scatter.monte_carlo import simulate_photons
from ...xray.primary_beam import transmit
from ...xray.resolved_technique import resolve_technique
from ...xray.spectrum import compute_beam
from .scatter_phantoms import Row, build_limb, build_slab

# Number of photons per case.
_PHOTONS = 8_000_000
# Edge length of a scoring cell at the detector, in mm.
_CELL_MM = 10.0
# Width and height of the field at the detector, in mm.
_FIELD_SIZES_MM = {"slab": (300, 300), "limb": (240, 300)}
# Indices (batch, row, column) of the averaged scoring cells: central for a slab, behind the bone core for a limb.
_MEASURED_CELLS = {"slab": np.s_[:, 12:18, 12:18], "limb": np.s_[:, 4:26, 10:14]}


def compare_monte_carlo_with_reference(workers: int, photons: int = _PHOTONS) -> list[Row]:
    """Compare the Monte Carlo scatter code with independent Monte Carlo code, for each case in ``data/reference.toml``.

    Parameters
    ----------
    workers : int
        Number of worker processes.
    photons : int, default 8_000_000
        Number of photons per case.

    Returns
    -------
    list of dict
        One row per case. ``quantity`` is the ratio of scatter to primary for a slab, and of scatter to open beam for a
        limb. ``error_percent`` is the standard error of the value. ``difference_percent`` is the difference from the
        reference value, which has an error of 1 to 2 %. ``primary_percent``, for limbs only, is the relative difference
        between the reference primary signal and the Beer-Lambert law.
    """
    known, known_tissues = load_reference_tables().scatter, load_tissues()
    cases = [("slab", case) for case in known.slab] + [("limb", case) for case in known.limb]
    return [_compare_case(kind, case, known_tissues, workers, photons) for kind, case in cases]


def _compare_case(
    kind: str, case: tuple[float, ...], known_tissues: Mapping[str, Tissue], workers: int, photons: int
) -> Row:
    """Simulate one case and compare it with its reference value."""
    kv, thick_mm, gap_mm, *expected = case
    cols, rows = _FIELD_SIZES_MM[kind]
    coarse = replace(load_protocol("reference"), rows=rows, cols=cols, pixel_mm=1.0, tube_kv=kv)
    protocol = replace(coarse, sod_mm=1150.0 - gap_mm - thick_mm / 2)
    scene = build_slab(thick_mm) if kind == "slab" else build_limb(thick_mm, known_tissues)
    technique = use_fitted_detector(resolve_technique(protocol))
    counts = simulate_photons(scene, technique, photons=photons, seed=1, workers=workers, cell_mm=_CELL_MM)
    beam = compute_beam(technique)
    opened = float(transmit({}, beam, technique, workers).kev[rows // 2, cols // 2])
    behind = transmit(trace(scene, protocol, workers=workers).path_mm, beam, technique, workers).kev
    read = _MEASURED_CELLS[kind]
    # The primary signal is computed from the Beer-Lambert law, because counted photons would add quantum noise.
    primary = float(downsample_by_blocks(behind, counts.pixels_per_cell)[read[1:]].mean()) / opened
    scatter = counts.scatter_kev[read].sum(axis=(1, 2)) / (counts.pixels[read[1:]].sum() * opened)
    value = scatter.mean() / (primary if kind == "slab" else 1.0)
    return {
        "object": kind, "tube_kv": kv, "thickness_mm": thick_mm, "gap_mm": gap_mm,
        "quantity": "scatter over primary" if kind == "slab" else "scatter over open beam",
        "value": float(f"{value:.4g}"), "reference": expected[-1],
        "error_percent": round(float(100 * scatter.std(ddof=1) / np.sqrt(len(scatter)) / scatter.mean()), 2),
        "difference_percent": round(float(100 * (value / expected[-1] - 1)), 2),
        "primary_percent": round(float(100 * (expected[0] / primary - 1)), 2) if kind == "limb" else "",
    }  # fmt: skip
