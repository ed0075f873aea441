"""Scatter: the fast kernel beside the Monte Carlo that it was calibrated against, and phantoms for both."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh
import xraylib
from numpy.typing import NDArray
from scipy import ndimage

from ..anatomy import build
from ..core.blocks import block_mean
from ..core.checks import Array
from ..data.tissues import Tissue, tissues
from ..geometry.scene import Scene, Surface
from ..model.knee import Knee
from ..model.protocol import Protocol, load_protocol
from ..raycast import trace
from ..scatter.kernel import exit_gaps_mm, middle_gap_mm, scatter_kev
from ..scatter.monte_carlo import Counts, count
from ..xray.materials import material_of
from ..xray.primary import transmit
from ..xray.spectrum import beam_of
from ..xray.technique import Technique, technique_of

Row = dict[str, Any]
Case = tuple[str, float, float, float]
# Object, tube kV, thickness (mm; of a knee at the joint), gap behind the box around it (mm): those that
# `data/scatter.toml` was fitted to, and others.
FITTED: tuple[Case, ...] = (
    ("knee", 60, 100, 20), ("knee", 60, 100, 150), ("knee", 60, 120, 30), ("knee", 60, 130, 180),
    ("knee", 60, 140, 20), ("knee", 60, 140, 150), ("knee", 65, 110, 40), ("knee", 70, 120, 20),
    ("knee", 70, 120, 70), ("knee", 70, 120, 150), ("knee", 70, 120, 190), ("knee", 75, 130, 120),
    ("knee", 80, 100, 60), ("knee", 80, 100, 150), ("knee", 80, 140, 20), ("bent knee", 60, 110, 140),
    ("bent knee", 60, 130, 40), ("bent knee", 70, 120, 82), ("bent knee", 70, 140, 20), ("bent knee", 80, 110, 130),
    ("limb", 60, 100, 150), ("limb", 60, 130, 200), ("limb", 60, 140, 60), ("limb", 70, 100, 80),
    ("limb", 70, 120, 60), ("limb", 70, 140, 20), ("limb", 75, 130, 40), ("limb", 80, 100, 20),
    ("limb", 80, 110, 200), ("limb", 80, 140, 150), ("slab", 60, 100, 80), ("slab", 70, 120, 20),
    ("slab", 70, 120, 150), ("slab", 80, 140, 80),
)  # fmt: skip
CHECKED: tuple[Case, ...] = (
    ("knee", 60, 110, 120), ("knee", 60, 120, 80), ("knee", 65, 130, 150), ("knee", 70, 130, 80),
    ("knee", 70, 140, 110), ("knee", 75, 110, 20), ("knee", 75, 120, 60), ("knee", 80, 120, 20),
    ("knee", 80, 120, 80), ("knee", 80, 130, 50), ("bent knee", 65, 130, 90), ("bent knee", 70, 110, 60),
    ("bent knee", 75, 100, 30), ("bent knee", 80, 140, 60), ("limb", 60, 120, 20), ("limb", 60, 120, 110),
    ("limb", 65, 130, 90), ("limb", 70, 120, 150), ("limb", 75, 110, 100), ("limb", 80, 120, 140),
)  # fmt: skip
# The same of knees that rays meet from behind: upright, and as they lean under the protocols so called.
FITTED_PA: tuple[Case, ...] = (
    ("knee from behind", 60, 100, 80), ("knee from behind", 70, 120, 30), ("knee from behind", 70, 130, 150),
    ("knee from behind", 80, 110, 60), ("fixed_flexion", 60, 100, 40), ("fixed_flexion", 60, 130, 60),
    ("fixed_flexion", 65, 120, 150), ("fixed_flexion", 70, 110, 100), ("fixed_flexion", 70, 120, 25),
    ("fixed_flexion", 80, 120, 40), ("fixed_flexion", 80, 140, 80), ("rosenberg", 60, 110, 80),
    ("rosenberg", 70, 120, 25), ("rosenberg", 80, 130, 60), ("lyon_schuss", 70, 120, 30), ("lyon_schuss", 75, 100, 120),
)  # fmt: skip
CHECKED_PA: tuple[Case, ...] = (
    ("knee from behind", 70, 110, 100), ("fixed_flexion", 65, 110, 30), ("fixed_flexion", 70, 130, 60),
    ("fixed_flexion", 75, 120, 90), ("rosenberg", 65, 120, 50), ("lyon_schuss", 60, 130, 40),
)  # fmt: skip
_LEANING, SYMMETRIC = ("fixed_flexion", "rosenberg", "lyon_schuss"), ("limb", "slab")
# The joint region, mm on the detector: rows, columns.
_REGION_MM = (80.0, 60.0)
CELL_MM = 9.6


def scatter_rows(
    photons: int = 8_000_000,
    workers: int = 2,
    cases: tuple[Case, ...] = (*FITTED, *FITTED_PA, *CHECKED, *CHECKED_PA),
) -> list[Row]:
    """One row a case: scatter over the open beam in the joint region, by Monte Carlo and by kernel.

    exit_gap_mm         in the middle of what the kernel is given: see `scatter.kernel.middle_gap_mm`
    error_percent       of the Monte Carlo's mean over the region, one standard deviation
    difference_percent  of the kernel's mean over the region
    worst_percent       the kernel's largest difference within it, both smoothed by 10 mm
    """
    rows = []
    known_tissues = tissues()
    for case in cases:
        run = measured(case, known_tissues, photons, workers)
        opened = float(transmit({}, beam_of(run.technique), run.technique, workers).kev.max())
        fast = block_mean(scatter_kev(run.primary, run.path_mm, run.gaps_mm, run.technique), run.counts.step) / opened
        slow = run.counts.scatter_kev / run.counts.pixels / opened
        known = {"used_to_fit": case in (*FITTED, *FITTED_PA), "exit_gap_mm": round(middle_gap_mm(run.gaps_mm), 1)}
        rows.append({**known, **_compared(case, slow, fast)})
    return rows


@dataclass(frozen=True, kw_only=True)
class Run:
    """A case by Monte Carlo, and what the kernel starts from: primary (keV a pixel) and path lengths, (rows, cols)."""

    technique: Technique
    gaps_mm: Array
    counts: Counts
    primary: NDArray[np.float32]
    path_mm: Mapping[str, NDArray[np.float32]]


def measured(case: Case, known: Mapping[str, Tissue], photons: int, workers: int) -> Run:
    """A case by Monte Carlo.

    known  tissues by name
    """
    scene, protocol = case_of(case, known)
    technique, paths = technique_of(protocol), trace(scene, protocol, workers=workers).path_mm
    return Run(
        technique=technique,
        gaps_mm=exit_gaps_mm(scene, technique.view),
        counts=count(scene, technique, photons=photons, seed=7, workers=workers, cell_mm=CELL_MM),
        primary=transmit(paths, beam_of(technique), technique, workers).kev,
        path_mm=paths,
    )


def _compared(case: Case, slow: Array, fast: Array) -> Row:
    """Monte Carlo (batches, rows, cols) and kernel (rows, cols) in the joint region."""
    half = [round(mm / CELL_MM / 2) for mm in _REGION_MM]
    region = tuple(slice(n // 2 - h, n // 2 + h) for n, h in zip(fast.shape, half, strict=True))
    means = slow[:, *region].mean(axis=(1, 2))
    even = [ndimage.gaussian_filter(part, 10.0 / CELL_MM)[region] for part in (slow.mean(axis=0), fast)]
    spread = 100 * (even[1] / even[0] - 1)
    return {
        "object": case[0],
        "tube_kv": case[1],
        "thickness_mm": case[2],
        "gap_mm": case[3],
        "monte_carlo": float(f"{means.mean():.4g}"),
        "error_percent": round(float(100 * means.std(ddof=1) / np.sqrt(len(means)) / means.mean()), 2),
        "kernel": float(f"{fast[region].mean():.4g}"),
        "difference_percent": round(float(100 * (fast[region].mean() / means.mean() - 1)), 2),
        "worst_percent": round(float(spread.flat[np.abs(spread).argmax()]), 2),
    }


def case_of(case: Case, known: Mapping[str, Tissue]) -> tuple[Scene, Protocol]:
    """The scene and protocol of a case: as in `reference`, or in that which it is called by, in pixels of 1.2 mm.

    known  tissues by name
    """
    kind, kv, thick_mm, gap_mm = case
    protocol = load_protocol(kind if kind in _LEANING else "reference")
    if kind == "knee from behind":
        protocol = replace(protocol, projection="PA")
    if kind in SYMMETRIC:
        scene = limb(thick_mm, known) if kind == "limb" else slab(thick_mm)
    elif kind == "bent knee":
        woman = Knee(sex="female", stature_mm=1620.0, side="left", fat_mm=16.0, limb_ap_mm=thick_mm)
        scene = build(replace(woman, flexion_deg=6.0, rotation_deg=5.0, varus_deg=-3.0)).scene
    else:
        built = build(Knee(limb_ap_mm=thick_mm), protocol)
        scene, protocol = built.scene, built.aimed(protocol)
    coarse = replace(protocol, rows=256, cols=256, pixel_mm=1.2, tube_kv=float(kv))
    return scene, replace(coarse, sod_mm=protocol.sdd_mm - gap_mm - float(scene.bounds_mm[1, 1]))


def limb(thick_mm: float, known: Mapping[str, Tissue]) -> Scene:
    """A long elliptic limb, 1.2 times as wide as thick, 70 % muscle and 30 % fat, with a core of bone.

    The core is 17 % cortical bone in marrow, 0.6 of the limb's width and 0.45 of its thickness.

    known  tissues by name
    """
    soft = mixture({"muscle": 0.7, "adipose": 0.3}, known)
    core = mixture({"cortical_bone": 0.17, "marrow": 0.83}, known)
    outer, inner = _cylinder(0.6 * thick_mm, 0.5 * thick_mm), _cylinder(0.36 * thick_mm, 0.225 * thick_mm)
    return Scene([Surface(outer, soft, "air", "limb"), Surface(inner, core, soft, "core")])


def slab(thick_mm: float, side_mm: float = 440.0) -> Scene:
    """A square slab of water across the beam."""
    return Scene([Surface(trimesh.creation.box((side_mm, thick_mm, side_mm)), "water", "air", "slab")])


def mixture(volumes: Mapping[str, float], known: Mapping[str, Tissue]) -> str:
    """Tissues, of those that are known by name, mixed by volume as one: "FORMULA@DENSITY"."""
    parts = [(share, material_of(name, known)) for name, share in volumes.items()]
    density = sum(share * part.density_g_per_cm3 for share, part in parts)
    moles = dict[int, float]()
    for share, part in parts:
        for z, weight in part.elements:
            grams = share * part.density_g_per_cm3 / density * weight
            moles[z] = moles.get(z, 0.0) + 100 * grams / xraylib.AtomicWeight(z)
    formula = "".join(f"{xraylib.AtomicNumberToSymbol(z)}{count:.5f}" for z, count in moles.items())
    return f"{formula}@{density:.6f}"


def _cylinder(half_x_mm: float, half_y_mm: float) -> trimesh.Trimesh:
    """An upright elliptic cylinder, 420 mm long; a polygon of 192 sides with the ellipse's area."""
    sides = 192
    same_area = np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))
    mesh = trimesh.creation.cylinder(radius=1.0, height=420.0, sections=sides)
    return mesh.apply_scale([half_x_mm * same_area, half_y_mm * same_area, 1.0])
