"""A protocol measured as a physicist would: its figures beside references, and the curves behind them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.checks import Array
from ..data.references import References, references
from ..model.protocol import Protocol
from ..xray.technique import technique_of
from .beam import beam_quantities
from .detector import Curve, dqe, mtf, nnps, noise_moments, photon_transfer
from .exposure import cell_px, exposure_quantities

Row = dict[str, Any]
# Order of the references in `data/reference.toml`.
_BEAM = ("hvl1_mm_al", "hvl2_mm_al", "mean_kev", "photons_per_mm2_mas_1m", "air_kerma_ugy_mas_1m")
_MTF_AT, _DQE_AT = (0.5, 1.0, 2.0, 3.0), (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Quality:
    """What was measured of a protocol.

    rows      quantity, value, reference, low, high, source; a row a figure
    mtf, nnps, dqe  curves; the DQE in an RQA5 beam
    transfer  mean, variance and the variance meant of flat fields by rising mAs
    spr       (rows, cols)  scatter over primary on the radiograph of the average knee, in cells of cell_mm, some 2 mm
    """

    rows: list[Row]
    mtf: Curve
    nnps: Curve
    dqe: Curve
    transfer: list[tuple[float, float, float]]
    spr: Array
    cell_mm: float


def measure_quality(protocol: Protocol, progress: Callable[[str], None] = lambda what: None) -> Quality:
    """Measure a protocol as a physicist would: beam, detector, and a radiograph of the average knee.

    One knee stands before the middle of the detector also where the protocol takes two.
    """
    protocol = replace(protocol, apart_mm=0.0)
    radiographed, technique = technique_of(protocol), technique_of(replace(protocol, beam_along="horizontal"))
    protocol, held_against = technique.protocol, references()
    values = beam_quantities(technique)
    progress("detector")
    sharp, noise = mtf(technique), nnps(technique)
    # The standard beam for DQE, at an exposure in the middle of the range.
    efficiency = dqe(technique.taken(tube_kv=70.0, filtration_mm_al=23.5, mas=3.0, mono_kev=None))
    transfer = photon_transfer(technique)
    progress("radiograph")
    exposed, spr = exposure_quantities(radiographed)
    values |= exposed
    values |= {f"mtf_{f:g}_per_mm": float(np.interp(f, sharp.per_mm, sharp.measured)) for f in _MTF_AT}
    values |= {f"dqe_{f:g}_per_mm": float(np.interp(f, efficiency.per_mm, efficiency.measured)) for f in _DQE_AT}
    values |= {
        "mtf_over_model_worst": _worst(sharp, 3.0),
        "nps_over_model_mean": float(np.mean(noise.measured / noise.model)),
        "variance_over_model_mean": float(np.mean([measured / meant for _, measured, meant in transfer])),
    }
    rows = [_row(name, value, protocol, held_against) for name, value in values.items()]
    for name, (value, low, high) in noise_moments(technique).items():
        bounds = {"reference": "", "low": f"{low:.5g}", "high": f"{high:.5g}", "source": "normal, by the sample count"}
        rows.append({"quantity": name, "value": f"{value:.5g}", **bounds})
    return Quality(rows, sharp, noise, efficiency, transfer, spr, cell_px(protocol) * protocol.pixel_mm)


def _worst(curve: Curve, up_to_per_mm: float) -> float:
    """The ratio of measured to model that is farthest from 1."""
    ratio = (curve.measured / curve.model)[(curve.per_mm > 0) & (curve.per_mm <= up_to_per_mm)]
    return float(ratio[np.abs(ratio - 1).argmax()])


def _row(name: str, value: float, protocol: Protocol, known_values: References) -> Row:
    row: Row = {"quantity": name, "value": f"{value:.5g}", "reference": "", "low": "", "high": "", "source": ""}
    beam = known_values.beam.get(f"{protocol.tube_kv:g}_{protocol.filtration_mm_al:g}")
    if name in _BEAM and beam and protocol.anode_angle_deg == 12.0 and protocol.mono_kev is None:
        return row | {"reference": beam[_BEAM.index(name)], "source": "SpekPy 2.5.4"}
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
