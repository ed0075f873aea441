"""Measure the image quality of a protocol and compare it with reference values."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.checks import Array
from ..data.analysis.reference_table import ReferenceTables, load_reference_tables
from ..model.protocol import Protocol
from ..xray.resolved_technique import resolve_technique
from .beam_quality import compute_beam_quantities
from .detector_quality import (
    FrequencyCurve,
    measure_dqe,
    measure_mtf,
    measure_nnps,
    measure_noise_moments,
    measure_photon_transfer,
)
from .exposure_index import measure_exposure_quantities, spr_cell_px

Row = dict[str, Any]
# Names of the beam quantities, in the order of the reference values in `data/reference.toml`.
_BEAM_QUANTITIES = ("hvl1_mm_al", "hvl2_mm_al", "mean_kev", "photons_per_mm2_mas_1m", "air_kerma_ugy_mas_1m")
# Spatial frequencies at which the MTF is reported, in cycles per mm.
_MTF_AT = (0.5, 1.0, 2.0, 3.0)
# Spatial frequencies at which the DQE is reported, in cycles per mm.
_DQE_AT = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class QualityResult:
    """Measured image quality of a protocol.

    Attributes
    ----------
    rows : list of dict
        One row per quantity, with the keys quantity, value, reference, low, high and source.
    mtf : FrequencyCurve
        Presampled MTF.
    nnps : FrequencyCurve
        Normalised noise power spectrum of flat fields, in mm2.
    dqe : FrequencyCurve
        Detective quantum efficiency in an RQA5 beam.
    photon_transfer : list of (mean, measured, model) tuple of float
        Photon transfer of flat fields with increasing mAs: mean in DN, measured variance and model variance in DN2.
    spr : (rows, cols) array
        Scatter-to-primary-ratio map of the default knee; the cell size is `spr_cell_mm`.
    spr_cell_mm : float
        Cell size of the scatter-to-primary-ratio map in mm, about 2 mm.
    """

    rows: list[Row]
    mtf: FrequencyCurve
    nnps: FrequencyCurve
    dqe: FrequencyCurve
    photon_transfer: list[tuple[float, float, float]]
    spr: Array
    spr_cell_mm: float


def measure_quality(protocol: Protocol, progress: Callable[[str], None] = lambda what: None) -> QualityResult:
    """Measure the image quality of a protocol: the beam, the detector and a radiograph of the default knee.

    A protocol for two knees is measured with one knee at the centre of the detector.

    Parameters
    ----------
    protocol : Protocol
        Protocol to measure.
    progress : callable
        Function that receives the name of each measurement when the measurement starts.

    Returns
    -------
    QualityResult
        Quantities with reference values, and measured curves.
    """
    protocol = replace(protocol, knee_distance_mm=0.0)
    radiographed, technique = resolve_technique(protocol), resolve_technique(replace(protocol, beam_along="horizontal"))
    protocol, held_against = technique.protocol, load_reference_tables()
    values = compute_beam_quantities(technique)
    progress("detector")
    sharp, noise = measure_mtf(technique), measure_nnps(technique)
    # The DQE is measured in the standard beam RQA5, at an exposure in the middle of the detector range.
    efficiency = measure_dqe(
        technique.replace_protocol(
            tube_kv=70.0, filtration_mm_al=23.5, mas=3.0, mono_kev=None, filters=(), spectrum=None
        )
    )
    transfer = measure_photon_transfer(technique)
    progress("radiograph")
    exposed, spr = measure_exposure_quantities(radiographed)
    values |= exposed
    values |= {f"mtf_{f:g}_per_mm": float(np.interp(f, sharp.frequency_per_mm, sharp.measured)) for f in _MTF_AT}
    values |= {
        f"dqe_{f:g}_per_mm": float(np.interp(f, efficiency.frequency_per_mm, efficiency.measured)) for f in _DQE_AT
    }
    values |= {
        "mtf_over_model_worst": _worst_ratio(sharp, 3.0),
        "nps_over_model_mean": float(np.mean(noise.measured / noise.model)),
        "variance_over_model_mean": float(np.mean([measured / meant for _, measured, meant in transfer])),
    }
    rows = [_make_row(name, value, protocol, held_against) for name, value in values.items()]
    for name, (value, low, high) in measure_noise_moments(technique).items():
        bounds = {"reference": "", "low": f"{low:.5g}", "high": f"{high:.5g}", "source": "normal noise, pixel count"}
        rows.append({"quantity": name, "value": f"{value:.5g}", **bounds})
    return QualityResult(rows, sharp, noise, efficiency, transfer, spr, spr_cell_px(protocol) * protocol.pixel_mm)


def _worst_ratio(curve: FrequencyCurve, up_to_per_mm: float) -> float:
    """Return the ratio of measured to model value that differs most from 1, at frequencies up to `up_to_per_mm`."""
    ratio = (curve.measured / curve.model)[(curve.frequency_per_mm > 0) & (curve.frequency_per_mm <= up_to_per_mm)]
    return float(ratio[np.abs(ratio - 1).argmax()])


def _make_row(name: str, value: float, protocol: Protocol, known_values: ReferenceTables) -> Row:
    """Make the table row of one quantity, with the reference value if the protocol has one."""
    row: Row = {"quantity": name, "value": f"{value:.5g}", "reference": "", "low": "", "high": "", "source": ""}
    beam = known_values.beam.get(f"{protocol.tube_kv:g}_{protocol.filtration_mm_al:g}")
    if name in _BEAM_QUANTITIES and beam and protocol.anode_angle_deg == 12.0 and protocol.has_plain_beam:
        return row | {"reference": beam[_BEAM_QUANTITIES.index(name)], "source": "SpekPy 2.5.4"}
    known = known_values.quality.get(name)
    if known is None or ("csi" in known.source and protocol.detector != "csi"):
        return row
    low, high = known.range or ("", "")
    return row | {
        "reference": "" if known.value is None else known.value,
        "low": low,
        "high": high,
        "source": known.source,
    }
