"""The Monte Carlo of scatter beside an independent one: slabs of water and elliptic limbs."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..core.blocks import block_mean
from ..data.references import references
from ..data.tissues import Tissue, tissues
from ..model.protocol import load_protocol
from ..raycast import trace
from ..scatter.monte_carlo import count
from ..xray.primary import transmit
from ..xray.spectrum import beam_of
from ..xray.technique import technique_of
from .scatter import Row, limb, slab

_PHOTONS = 8_000_000
_CELL_MM = 10.0
# Width and height of the field at the detector, mm, and where in it values are read: behind a slab in the middle,
# behind a limb along its bone.
_FIELDS = {"slab": (300, 300), "limb": (240, 300)}
_READ = {"slab": np.s_[:, 12:18, 12:18], "limb": np.s_[:, 4:26, 10:14]}


def reference_rows(workers: int, photons: int = _PHOTONS) -> list[Row]:
    """One row a case of `data/reference.toml`.

    quantity            scatter over primary of a slab, scatter over the open beam of a limb
    error_percent       of the value, one standard deviation
    difference_percent  from the reference, which has an error of 1 to 2 % of its own
    primary_percent     by how much the reference's primary is off Beer and Lambert's, of limbs
    """
    known, known_tissues = references().scatter, tissues()
    cases = [("slab", case) for case in known.slab] + [("limb", case) for case in known.limb]
    return [_row(kind, case, known_tissues, workers, photons) for kind, case in cases]


def _row(kind: str, case: tuple[float, ...], known: Mapping[str, Tissue], workers: int, photons: int) -> Row:
    kv, thick_mm, gap_mm, *expected = case
    cols, rows = _FIELDS[kind]
    coarse = replace(load_protocol("reference"), rows=rows, cols=cols, pixel_mm=1.0, tube_kv=kv)
    protocol = replace(coarse, sod_mm=1150.0 - gap_mm - thick_mm / 2)
    scene = slab(thick_mm) if kind == "slab" else limb(thick_mm, known)
    technique = technique_of(protocol)
    counts = count(scene, technique, photons=photons, seed=1, workers=workers, cell_mm=_CELL_MM)
    beam = beam_of(technique)
    opened = float(transmit({}, beam, technique, workers).kev[rows // 2, cols // 2])
    behind = transmit(trace(scene, protocol, workers=workers).path_mm, beam, technique, workers).kev
    read = _READ[kind]
    # The primary by Beer and Lambert: counted photons would bring an error of their own.
    primary = float(block_mean(behind, counts.step)[read[1:]].mean()) / opened
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
