"""Comparison of spectrum, attenuation, primary and scattered signal with reference values."""

import dataclasses
from typing import Any

import numpy as np

from ...core.checks import Array
from ...data.analysis.reference_table import load_reference_tables
from ...data.anatomy.tissue_table import load_tissues
from ...model.protocol import load_protocol
from ...scatter.detector_correction import use_fitted_detector
from ...scatter.scatter_kernel import compute_air_gaps_mm, compute_kernel_scatter_kev
from ...xray.materials import attenuation_per_mm, resolve_material
from ...xray.primary_beam import transmit
from ...xray.resolved_technique import resolve_technique
from ...xray.spectrum import compute_reduced_beam, tube_spectrum
from .scatter_phantoms import build_limb

Row = dict[str, Any]
# Sources of the reference values.
_SPEKPY = "SpekPy 2.5.4 with another energy grid"
_MONTE_CARLO = "independent Monte Carlo, 2 %"
# Groups of quantities, each with the source of the reference values.
_FLUENCE = ("tube fluence", _SPEKPY)
_ENERGY = ("mean energy of the tube spectrum", _SPEKPY)
_ATTENUATION = ("attenuation of tissues at 40 and 60 keV", "ICRU 46, xraylib")
_PRIMARY = ("primary signal behind the centre of an elliptical limb phantom", _MONTE_CARLO)
_SCATTER = ("kernel scatter behind the same phantom, air gap of 60 to 140 mm", _MONTE_CARLO)
_NEAR_SCATTER = ("kernel scatter behind the same phantom, air gap of 15 mm, below the fitted range", _MONTE_CARLO)
# Smallest air gap for which the scatter kernel was fitted, in mm.
_SMALLEST_FITTED_GAP_MM = 20.0


def compare_physics_with_references() -> list[Row]:
    """Compare physical quantities with reference values.

    Returns
    -------
    list of dict
        One row per quantity: value, reference value and relative difference in percent. ``group`` is the group in which
        the quantity is reported, and ``source`` the source of the reference value.
    """
    known, named = load_reference_tables(), load_tissues()
    rows = []
    for kv, (fluence, mean_kev) in known.spectrum.items():
        energies, photons = tube_spectrum(float(kv), 12.0, 3.0)
        rows.append(_make_row(f"fluence at {kv} kV, photons/mm2/mAs at 1 m", photons.sum(), fluence, *_FLUENCE))
        mean = (energies * photons).sum() / photons.sum()
        rows.append(_make_row(f"mean energy at {kv} kV, keV", mean, mean_kev, *_ENERGY))
    for tissue, values in known.attenuation.items():
        for kev, value in zip((40.0, 60.0), values, strict=True):
            mu = float(attenuation_per_mm(resolve_material(tissue, named), np.array([kev]))[0]) * 10
            rows.append(_make_row(f"attenuation of {tissue} at {kev:g} keV, 1/cm", mu, value, *_ATTENUATION))
    for tube_kv, thick, gap, primary, scatter in known.scatter.limb:
        primary_here, scatter_here = compute_limb_signals(tube_kv, thick, gap)
        where = f"behind bone, {tube_kv:g} kV, limb {thick:g} mm, gap {gap:g} mm, over open beam"
        rows.append(_make_row(f"primary {where}", primary_here, primary, *_PRIMARY))
        where_fitted = _NEAR_SCATTER if gap < _SMALLEST_FITTED_GAP_MM else _SCATTER
        rows.append(_make_row(f"scatter {where}", scatter_here, scatter, *where_fitted))
    return rows


def compute_limb_signals(kv: float, thick_mm: float, gap_mm: float) -> tuple[float, float]:
    """Compute primary and scattered signal behind the centre of an elliptical limb phantom, relative to the open beam.

    The limb is 1.2 times wider than it is thick. Scatter is computed with the scatter kernel, and
    the detector is that of the kernel fit and of the references: each photon that interacts deposits its entire energy.

    Parameters
    ----------
    kv : float
        Tube voltage in kV.
    thick_mm : float
        Thickness of the limb along the beam, in mm.
    gap_mm : float
        Air gap between the limb and the detector, in mm.

    Returns
    -------
    tuple of float
        Primary and scattered signal divided by the open beam.
    """
    protocol = dataclasses.replace(
        load_protocol("reference"), tube_kv=kv, rows=300, cols=180, pixel_mm=1.0, sod_mm=1150.0 - gap_mm - thick_mm / 2
    )
    technique = use_fitted_detector(resolve_technique(protocol))
    whole = _ellipse_chords_mm(0.6 * thick_mm, 0.5 * thick_mm, protocol.sod_mm)
    core = _ellipse_chords_mm(0.36 * thick_mm, 0.225 * thick_mm, protocol.sod_mm)
    soft = whole - core
    parts = {"muscle": 0.7 * soft, "adipose": 0.3 * soft, "cortical_bone": 0.17 * core, "marrow": 0.83 * core}
    paths = {name: np.tile(line.astype(np.float32), (300, 1)) for name, line in parts.items()}
    beam = compute_reduced_beam(technique, {name: float(lengths.max()) for name, lengths in paths.items()})
    primary = transmit(paths, beam, technique).kev
    opened = transmit({}, beam, technique).kev[150, 90]
    gaps_mm = compute_air_gaps_mm(build_limb(thick_mm, technique.tissues), technique.view)
    scattered = compute_kernel_scatter_kev(primary, paths, gaps_mm, technique)
    return float(primary[150, 90] / opened), float(scattered[150, 90] / opened)


def _ellipse_chords_mm(half_x_mm: float, half_y_mm: float, sod_mm: float) -> Array:
    """Compute the chord lengths (180,) of rays through a long elliptical cylinder along z, in mm.

    The rays end at 180 pixels of 1 mm in a detector row, 1150 mm from the source.
    """
    x = np.arange(180) - 89.5
    a = (x / half_x_mm) ** 2 + (1150.0 / half_y_mm) ** 2
    b, c = -2 * sod_mm * 1150.0 / half_y_mm**2, (sod_mm / half_y_mm) ** 2 - 1
    return np.asarray(np.sqrt(np.maximum(b * b - 4 * a * c, 0)) / a * np.hypot(x, 1150.0))


def _make_row(quantity: str, value: float, reference: float, group: str, source: str) -> Row:
    """Make a table row with value, reference value and their relative difference in percent."""
    difference = round(100 * (float(value) / reference - 1), 2)
    return {
        "quantity": quantity,
        "value": f"{value:.5g}",
        "reference": f"{reference:.5g}",
        "difference_percent": difference,
        "group": group,
        "source": source,
    }
