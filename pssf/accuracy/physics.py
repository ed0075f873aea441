"""The package beside its references: physics."""

import dataclasses
from typing import Any

import numpy as np

from ..core.checks import Array
from ..data.references import references
from ..data.tissues import tissues
from ..model.protocol import load_protocol
from ..scatter.kernel import exit_gaps_mm, scatter_kev
from ..xray.materials import attenuation_per_mm, material_of
from ..xray.primary import transmit
from ..xray.spectrum import beam_for, tube_spectrum
from ..xray.technique import technique_of
from .scatter import limb

Row = dict[str, Any]
# Groups of quantities, and where their references come from.
_SPEKPY, _MONTE_CARLO = "SpekPy 2.5.4 at another setting of its grid", "an independent Monte Carlo, 2 %"
_FLUENCE, _ENERGY = ("fluence of the tube", _SPEKPY), ("mean energy of the tube", _SPEKPY)
_ATTENUATION = ("attenuation of tissues at 40 and 60 keV", "ICRU 46, xraylib")
_PRIMARY = ("primary behind the middle of an elliptic limb", _MONTE_CARLO)
_SCATTER = ("kernel scatter there, gaps of 60 to 140 mm", _MONTE_CARLO)
_NEAR = ("kernel scatter there, a gap of 15 mm, nearer than it was fitted to", _MONTE_CARLO)
_FITTED_GAP_MM = 20.0


def physics_rows() -> list[Row]:
    """One row a quantity: what the package gives, the reference, and the relative difference in percent.

    group   of quantities that are told of together
    source  of the reference
    """
    known, named = references(), tissues()
    rows = []
    for kv, (fluence, mean_kev) in known.spectrum.items():
        energies, photons = tube_spectrum(float(kv), 12.0, 3.0)
        rows.append(_row(f"fluence at {kv} kV, photons/mm2/mAs at 1 m", photons.sum(), fluence, *_FLUENCE))
        mean = (energies * photons).sum() / photons.sum()
        rows.append(_row(f"mean energy at {kv} kV, keV", mean, mean_kev, *_ENERGY))
    for tissue, values in known.attenuation.items():
        for kev, value in zip((40.0, 60.0), values, strict=True):
            mu = float(attenuation_per_mm(material_of(tissue, named), np.array([kev]))[0]) * 10
            rows.append(_row(f"attenuation of {tissue} at {kev:g} keV, 1/cm", mu, value, *_ATTENUATION))
    for tube_kv, thick, gap, primary, scatter in known.scatter.limb:
        primary_here, scatter_here = limb_signals(tube_kv, thick, gap)
        where = f"behind bone, {tube_kv:g} kV, limb {thick:g} mm, gap {gap:g} mm, over open beam"
        rows.append(_row(f"primary {where}", primary_here, primary, *_PRIMARY))
        where_fitted = _NEAR if gap < _FITTED_GAP_MM else _SCATTER
        rows.append(_row(f"scatter {where}", scatter_here, scatter, *where_fitted))
    return rows


def limb_signals(kv: float, thick_mm: float, gap_mm: float) -> tuple[float, float]:
    """Primary and scatter over the open beam, behind the middle of an elliptic limb 1.2 times as wide as thick."""
    protocol = dataclasses.replace(
        load_protocol("reference"), tube_kv=kv, rows=300, cols=180, pixel_mm=1.0, sod_mm=1150.0 - gap_mm - thick_mm / 2
    )
    technique = technique_of(protocol)
    whole = _ellipse_chords(0.6 * thick_mm, 0.5 * thick_mm, protocol.sod_mm)
    core = _ellipse_chords(0.36 * thick_mm, 0.225 * thick_mm, protocol.sod_mm)
    soft = whole - core
    parts = {"muscle": 0.7 * soft, "adipose": 0.3 * soft, "cortical_bone": 0.17 * core, "marrow": 0.83 * core}
    paths = {name: np.tile(line.astype(np.float32), (300, 1)) for name, line in parts.items()}
    beam = beam_for(technique, {name: float(lengths.max()) for name, lengths in paths.items()})
    primary = transmit(paths, beam, technique).kev
    opened = transmit({}, beam, technique).kev[150, 90]
    gaps_mm = exit_gaps_mm(limb(thick_mm, technique.tissues), technique.view)
    scattered = scatter_kev(primary, paths, gaps_mm, technique)
    return float(primary[150, 90] / opened), float(scattered[150, 90] / opened)


def _ellipse_chords(half_x_mm: float, half_y_mm: float, sod_mm: float) -> Array:
    """(180,)  chords of a long elliptic cylinder about z, along one row of a detector at 1150 mm"""
    x = np.arange(180) - 89.5
    a = (x / half_x_mm) ** 2 + (1150.0 / half_y_mm) ** 2
    b, c = -2 * sod_mm * 1150.0 / half_y_mm**2, (sod_mm / half_y_mm) ** 2 - 1
    return np.asarray(np.sqrt(np.maximum(b * b - 4 * a * c, 0)) / a * np.hypot(x, 1150.0))


def _row(quantity: str, value: float, reference: float, group: str, source: str) -> Row:
    difference = round(100 * (float(value) / reference - 1), 2)
    return {
        "quantity": quantity,
        "value": f"{value:.5g}",
        "reference": f"{reference:.5g}",
        "difference_percent": difference,
        "group": group,
        "source": source,
    }
