"""The package beside its references: physics, labels and sizes of the knee."""

import dataclasses
from typing import Any

import numpy as np

from .anatomy import build, measured_jsw_mm
from .checks import Array
from .detector.materials import attenuation_per_mm
from .detector.primary import transmit
from .detector.scatter import scatter_kev
from .detector.spectrum import beam_of, tube_spectrum
from .files import tables
from .geometry import view_of
from .knee import Knee, draw_knee
from .protocol import load_protocol
from .scene import Scene

Row = dict[str, Any]


def physics_rows() -> list[Row]:
    """One row a quantity: what the package gives, the reference, and the relative difference in percent."""
    known = tables.data("reference")
    rows = []
    for kv, (fluence, mean_kev) in known["spectrum"].items():
        energies, photons = tube_spectrum(float(kv), 12.0, 3.0)
        rows.append(_row(f"fluence at {kv} kV, photons/mm2/mAs at 1 m", photons.sum(), fluence))
        rows.append(_row(f"mean energy at {kv} kV, keV", (energies * photons).sum() / photons.sum(), mean_kev))
    for tissue, values in known["attenuation"].items():
        for kev, value in zip((40.0, 60.0), values, strict=True):
            mu = float(attenuation_per_mm(tissue, np.array([kev]))[0]) * 10
            rows.append(_row(f"attenuation of {tissue} at {kev:g} keV, 1/cm", mu, value))
    for kv, thick, gap, primary, scatter in known["scatter"]["limb"]:
        found = limb_signals(kv, thick, gap)
        where = f"behind bone, {kv:g} kV, limb {thick:g} mm, gap {gap:g} mm, over open beam"
        rows.append(_row(f"primary {where}", found[0], primary))
        rows.append(_row(f"scatter {where}", found[1], scatter))
    return rows


def knee_rows(count: int = 60) -> list[Row]:
    """One row a quantity, over drawn knees of all grades: errors of the labels, and sizes measured on the meshes."""
    knees = [draw_knee(grade=k % 3, rng=np.random.default_rng(k)) for k in range(count)]
    scenes = [build(knee) for knee in knees]
    errors = np.array([
        np.subtract(measured_jsw_mm(knee, scene, load_protocol("reference")), (knee.jsw_medial_mm, knee.jsw_lateral_mm))
        for knee, scene in zip(knees, scenes, strict=True)
    ])  # fmt: skip
    rows = [
        {"quantity": f"error of jsw_{side}_mm on the projection, largest, mm", "value": float(f"{worst:.2g}")}
        for side, worst in zip(("medial", "lateral"), np.abs(errors).max(axis=0), strict=True)
    ]
    sizes = [(knee.sex, _sizes_mm(knee, scene)) for knee, scene in zip(knees, scenes, strict=True)]
    for name, entry in tables.data("reference")["morphometry"].items():
        for sex in ("male", "female"):
            values = np.array([size[name] for other, size in sizes if other == sex])
            rows.append({
                "quantity": f"{name}, {sex}", "value": round(float(values.mean()), 1),
                "sd": round(float(values.std(ddof=1)), 1), "knees": len(values),
                "reference": entry[sex], "source": entry["source"],
            })  # fmt: skip
    filled = ("quantity", "value", "sd", "knees", "reference", "source")
    return [{name: row.get(name, "") for name in filled} for row in rows]


def limb_signals(kv: float, thick_mm: float, gap_mm: float) -> tuple[float, float]:
    """Primary and scatter over the open beam, behind the middle of an elliptic limb 1.2 times as wide as thick."""
    protocol = dataclasses.replace(
        load_protocol("reference"), tube_kv=kv, rows=300, cols=180, pixel_mm=1.0, sod_mm=1150.0 - gap_mm - thick_mm / 2
    )
    view, beam = view_of(protocol), beam_of(protocol)
    limb = _ellipse_chords(0.6 * thick_mm, 0.5 * thick_mm, protocol.sod_mm)
    core = _ellipse_chords(0.36 * thick_mm, 0.225 * thick_mm, protocol.sod_mm)
    soft = limb - core
    parts = {"muscle": 0.7 * soft, "adipose": 0.3 * soft, "cortical_bone": 0.17 * core, "marrow": 0.83 * core}
    paths = {name: np.tile(line.astype(np.float32), (300, 1)) for name, line in parts.items()}
    primary = transmit(paths, beam, view).kev
    opened = transmit({}, beam, view).kev[150, 90]
    scattered = scatter_kev(primary, paths, gap_mm, protocol)
    return float(primary[150, 90] / opened), float(scattered[150, 90] / opened)


def _ellipse_chords(half_x_mm: float, half_y_mm: float, sod_mm: float) -> Array:
    """(180,)  chords of a long elliptic cylinder about z, along one row of a detector at 1150 mm"""
    x = np.arange(180) - 89.5
    a = (x / half_x_mm) ** 2 + (1150.0 / half_y_mm) ** 2
    b, c = -2 * sod_mm * 1150.0 / half_y_mm**2, (sod_mm / half_y_mm) ** 2 - 1
    return np.asarray(np.sqrt(np.maximum(b * b - 4 * a * c, 0)) / a * np.hypot(x, 1150.0))


def _sizes_mm(knee: Knee, scene: Scene) -> dict[str, float]:
    """Extents of the bones near the joint, turned back into the leg's own frame; osteophytes do not count."""
    bare = scene
    if knee.osteophytes or knee.rotation_deg or knee.flexion_deg:
        bare = build(dataclasses.replace(knee, osteophytes=(), rotation_deg=0.0, flexion_deg=0.0))
    points = {s.name: np.asarray(s.mesh.vertices) for s in bare.surfaces if s.name in ("femur", "tibia", "patella")}
    femur, tibia = points["femur"], points["tibia"]
    femur, tibia = femur[femur[:, 2] < 60.0], tibia[tibia[:, 2] > -15.0]
    return {
        "tibial_ml_mm": float(np.ptp(tibia[:, 0])),
        "tibial_ap_mm": float(np.ptp(tibia[:, 1])),
        "femoral_ml_mm": float(np.ptp(femur[:, 0])),
        "femoral_ap_mm": float(np.ptp(femur[:, 1])),
        "patellar_width_mm": float(np.ptp(points["patella"][:, 0])),
    }


def _row(quantity: str, value: float, reference: float) -> Row:
    difference = round(100 * (float(value) / reference - 1), 2)
    return {
        "quantity": quantity,
        "value": f"{value:.5g}",
        "reference": f"{reference:.5g}",
        "difference_percent": difference,
    }
