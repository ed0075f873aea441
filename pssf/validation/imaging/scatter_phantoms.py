"""Scatter phantoms, and comparison of the scatter kernel with the Monte Carlo simulation to which it was fitted."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import trimesh
import xraylib
from numpy.typing import NDArray
from scipy import ndimage

from ...anatomy import build
from ...core.checks import Array
from ...core.resample import downsample_by_blocks
from ...data.anatomy.tissue_table import Tissue, load_tissues
from ...geometry.scene import Scene, Surface
from ...model.detector import Detector, resolve_detector
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...raycast import trace
from ...scatter.detector_correction import make_fitted_detector
from ...scatter.monte_carlo import PhotonTally, simulate_photons
from ...scatter.scatter_kernel import central_air_gap_mm, compute_air_gaps_mm, compute_kernel_scatter_kev
from ...xray.materials import resolve_material
from ...xray.primary_beam import transmit
from ...xray.resolved_technique import Technique, resolve_technique
from ...xray.spectrum import compute_beam

Row = dict[str, Any]
ScatterCase = tuple[str, float, float, float]
# Each case lists the object, tube voltage (kV), thickness (mm; for knees, at the joint) and air gap behind the bounding
# box (mm).
# `data/scatter.toml` was fitted to the fit cases; the check cases were not used for the fit.
FIT_CASES: tuple[ScatterCase, ...] = (
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
CHECK_CASES: tuple[ScatterCase, ...] = (
    ("knee", 60, 110, 120), ("knee", 60, 120, 80), ("knee", 65, 130, 150), ("knee", 70, 130, 80),
    ("knee", 70, 140, 110), ("knee", 75, 110, 20), ("knee", 75, 120, 60), ("knee", 80, 120, 20),
    ("knee", 80, 120, 80), ("knee", 80, 130, 50), ("bent knee", 65, 130, 90), ("bent knee", 70, 110, 60),
    ("bent knee", 75, 100, 30), ("bent knee", 80, 140, 60), ("limb", 60, 120, 20), ("limb", 60, 120, 110),
    ("limb", 65, 130, 90), ("limb", 70, 120, 150), ("limb", 75, 110, 100), ("limb", 80, 120, 140),
)  # fmt: skip
# Cases in PA projection: upright knees, and knees positioned by the protocol with the name of the object.
FIT_CASES_PA: tuple[ScatterCase, ...] = (
    ("knee from behind", 60, 100, 80), ("knee from behind", 70, 120, 30), ("knee from behind", 70, 130, 150),
    ("knee from behind", 80, 110, 60), ("fixed_flexion", 60, 100, 40), ("fixed_flexion", 60, 130, 60),
    ("fixed_flexion", 65, 120, 150), ("fixed_flexion", 70, 110, 100), ("fixed_flexion", 70, 120, 25),
    ("fixed_flexion", 80, 120, 40), ("fixed_flexion", 80, 140, 80), ("rosenberg", 60, 110, 80),
    ("rosenberg", 70, 120, 25), ("rosenberg", 80, 130, 60), ("lyon_schuss", 70, 120, 30), ("lyon_schuss", 75, 100, 120),
)  # fmt: skip
CHECK_CASES_PA: tuple[ScatterCase, ...] = (
    ("knee from behind", 70, 110, 100), ("fixed_flexion", 65, 110, 30), ("fixed_flexion", 70, 130, 60),
    ("fixed_flexion", 75, 120, 90), ("rosenberg", 65, 120, 50), ("lyon_schuss", 60, 130, 40),
)  # fmt: skip
# Cases that are also simulated with other detectors than csi, and these detectors.
DETECTOR_CASES: tuple[ScatterCase, ...] = (
    ("knee", 70, 120, 70), ("limb", 60, 100, 150), ("limb", 80, 140, 20), ("fixed_flexion", 70, 120, 25),
)  # fmt: skip
OTHER_DETECTORS = ("gos", "ideal")
# Case objects that are knees positioned by the protocol with the same name.
_LEANING = ("fixed_flexion", "rosenberg", "lyon_schuss")
# Case objects whose anterior and posterior halves are mirror images.
SYMMETRIC = ("limb", "slab")
# Height and width of the joint region at the detector, in mm.
_JOINT_REGION_MM = (80.0, 60.0)
# Edge length of a scoring cell at the detector, in mm.
CELL_MM = 9.6


def compare_kernel_with_monte_carlo(
    photons: int = 8_000_000,
    workers: int = 2,
    cases: tuple[ScatterCase, ...] = (*FIT_CASES, *FIT_CASES_PA, *CHECK_CASES, *CHECK_CASES_PA),
    detectors: tuple[str, ...] = ("csi",),
) -> list[Row]:
    """Compare the scatter kernel with the Monte Carlo simulation in the joint region, relative to the open beam.

    Parameters
    ----------
    photons : int, default 8_000_000
        Number of photons per case.
    workers : int, default 2
        Number of worker processes.
    cases : tuple of tuple
        Object, tube voltage in kV, thickness in mm and air gap in mm of each case. The default is all fit and check
        cases.
    detectors : tuple of str, default ("csi",)
        Detectors with which each case is simulated.

    Returns
    -------
    list of dict
        One row per detector and case. ``exit_gap_mm`` is the mean central air gap from which the kernel is computed,
        see :func:`~pssf.scatter.scatter_kernel.central_air_gap_mm`. ``error_percent`` is the standard error of the
        Monte Carlo mean over the region. ``difference_percent`` is the difference between kernel mean and Monte Carlo
        mean. ``worst_percent`` is the largest difference in the region after both scatter images are smoothed by 10 mm.
    """
    rows = []
    known_tissues = load_tissues()
    for name, case in product(detectors, cases):
        run = run_monte_carlo(case, known_tissues, photons, workers, resolve_detector(name))
        opened = float(transmit({}, compute_beam(run.technique), run.technique, workers).kev.max())
        fast = (
            downsample_by_blocks(
                compute_kernel_scatter_kev(run.primary, run.path_mm, run.gaps_mm, run.technique),
                run.counts.pixels_per_cell,
            )
            / opened
        )
        slow = run.counts.scatter_kev / run.counts.pixels / opened
        known = {
            "detector": name,
            "used_to_fit": case in (*FIT_CASES, *FIT_CASES_PA),
            "exit_gap_mm": round(central_air_gap_mm(run.gaps_mm), 1),
        }
        rows.append({**known, **_compare_in_joint_region(case, slow, fast)})
    return rows


@dataclass(frozen=True, kw_only=True)
class MonteCarloRun:
    """Monte Carlo result of one case, and input data of the scatter kernel.

    Attributes
    ----------
    technique : Technique
        Resolved technique of the case.
    gaps_mm : (32, 32) array
        Air gap behind the object, in mm.
    counts : PhotonTally
        Energy scored by the Monte Carlo simulation.
    primary : (rows, cols) float32 array
        Primary signal in keV per pixel.
    path_mm : mapping of str to (rows, cols) float32 array
        Path length in each material, in mm.
    """

    technique: Technique
    gaps_mm: Array
    counts: PhotonTally
    primary: NDArray[np.float32]
    path_mm: Mapping[str, NDArray[np.float32]]


def run_monte_carlo(
    case: ScatterCase,
    known_tissues: Mapping[str, Tissue],
    photons: int,
    workers: int,
    detector: Detector | None = None,
) -> MonteCarloRun:
    """Simulate one case with the Monte Carlo code, and compute the primary signal by ray casting.

    Parameters
    ----------
    case : tuple of (str, float, float, float)
        Object, tube voltage in kV, thickness in mm and air gap in mm.
    known_tissues : mapping of str to Tissue
        Tissues by name.
    photons : int
        Number of photons.
    workers : int
        Number of worker processes.
    detector : Detector, optional
        Detector. The default is that of the kernel fit.

    Returns
    -------
    MonteCarloRun
        Monte Carlo result, and input data of the scatter kernel.
    """
    scene, protocol = build_case(case, known_tissues)
    technique, paths = resolve_technique(protocol), trace(scene, protocol, workers=workers).path_mm
    technique = replace(technique, detector=detector or make_fitted_detector(technique))
    return MonteCarloRun(
        technique=technique,
        gaps_mm=compute_air_gaps_mm(scene, technique.view),
        counts=simulate_photons(scene, technique, photons=photons, seed=7, workers=workers, cell_mm=CELL_MM),
        primary=transmit(paths, compute_beam(technique), technique, workers).kev,
        path_mm=paths,
    )


def _compare_in_joint_region(case: ScatterCase, monte_carlo: Array, kernel: Array) -> Row:
    """Compare Monte Carlo (batches, rows, cols) and kernel (rows, cols) scatter in the joint region."""
    half = [round(mm / CELL_MM / 2) for mm in _JOINT_REGION_MM]
    region = tuple(slice(n // 2 - h, n // 2 + h) for n, h in zip(kernel.shape, half, strict=True))
    means = monte_carlo[:, *region].mean(axis=(1, 2))
    even = [ndimage.gaussian_filter(part, 10.0 / CELL_MM)[region] for part in (monte_carlo.mean(axis=0), kernel)]
    spread = 100 * (even[1] / even[0] - 1)
    return {
        "object": case[0],
        "tube_kv": case[1],
        "thickness_mm": case[2],
        "gap_mm": case[3],
        "monte_carlo": float(f"{means.mean():.4g}"),
        "error_percent": round(float(100 * means.std(ddof=1) / np.sqrt(len(means)) / means.mean()), 2),
        "kernel": float(f"{kernel[region].mean():.4g}"),
        "difference_percent": round(float(100 * (kernel[region].mean() / means.mean() - 1)), 2),
        "worst_percent": round(float(spread.flat[np.abs(spread).argmax()]), 2),
    }


def build_case(case: ScatterCase, known_tissues: Mapping[str, Tissue]) -> tuple[Scene, Protocol]:
    """Build the scene and the protocol of a case, with 256 x 256 pixels of 1.2 mm.

    The protocol is the one named after the object if it exists, otherwise ``reference``.

    Parameters
    ----------
    case : tuple of (str, float, float, float)
        Object, tube voltage in kV, thickness in mm and air gap in mm.
    known_tissues : mapping of str to Tissue
        Tissues by name.

    Returns
    -------
    tuple of (Scene, Protocol)
        Scene and protocol.
    """
    kind, kv, thick_mm, gap_mm = case
    protocol = load_protocol(kind if kind in _LEANING else "reference")
    if kind == "knee from behind":
        protocol = replace(protocol, projection="PA")
    if kind in SYMMETRIC:
        scene = build_limb(thick_mm, known_tissues) if kind == "limb" else build_slab(thick_mm)
    elif kind == "bent knee":
        woman = Knee(sex="female", stature_mm=1620.0, side="left", fat_mm=16.0, limb_ap_mm=thick_mm)
        scene = build(replace(woman, flexion_deg=6.0, rotation_deg=5.0, varus_deg=-3.0)).scene
    else:
        built = build(Knee(limb_ap_mm=thick_mm), protocol)
        scene, protocol = built.scene, built.aim_beam(protocol)
    coarse = replace(protocol, rows=256, cols=256, pixel_mm=1.2, tube_kv=float(kv))
    return scene, replace(coarse, sod_mm=protocol.sdd_mm - gap_mm - float(scene.bounds_mm[1, 1]))


def build_limb(thick_mm: float, known_tissues: Mapping[str, Tissue]) -> Scene:
    """Build a long elliptical limb of soft tissue with a bone core; the limb is 1.2 times wider than thick.

    Soft tissue is 70 % muscle and 30 % fat by volume. The core is 17 % cortical bone and 83 % marrow. The core
    is 0.6 times as wide and 0.45 times as thick as the limb.

    Parameters
    ----------
    thick_mm : float
        Thickness of the limb along the beam, in mm.
    known_tissues : mapping of str to Tissue
        Tissues by name.

    Returns
    -------
    Scene
        Scene with the surfaces ``limb`` and ``core``.
    """
    soft = mix_tissues({"muscle": 0.7, "adipose": 0.3}, known_tissues)
    core = mix_tissues({"cortical_bone": 0.17, "marrow": 0.83}, known_tissues)
    outer, inner = _make_cylinder(0.6 * thick_mm, 0.5 * thick_mm), _make_cylinder(0.36 * thick_mm, 0.225 * thick_mm)
    return Scene([Surface(outer, soft, "air", "limb"), Surface(inner, core, soft, "core")])


def build_slab(thick_mm: float, side_mm: float = 440.0) -> Scene:
    """Build a square water slab perpendicular to the beam.

    Parameters
    ----------
    thick_mm : float
        Thickness along the beam, in mm.
    side_mm : float, default 440.0
        Edge length perpendicular to the beam, in mm.

    Returns
    -------
    Scene
        Scene with the surface ``slab``.
    """
    return Scene([Surface(trimesh.creation.box((side_mm, thick_mm, side_mm)), "water", "air", "slab")])


def mix_tissues(volumes: Mapping[str, float], known_tissues: Mapping[str, Tissue]) -> str:
    """Mix tissues by volume into one material.

    Parameters
    ----------
    volumes : mapping of str to float
        Volume fraction of each tissue.
    known_tissues : mapping of str to Tissue
        Tissues by name.

    Returns
    -------
    str
        Material as ``"FORMULA@DENSITY"``, with the density in g/cm3.
    """
    parts = [(share, resolve_material(name, known_tissues)) for name, share in volumes.items()]
    density = sum(share * part.density_g_per_cm3 for share, part in parts)
    moles = dict[int, float]()
    for share, part in parts:
        for z, weight in part.elements:
            grams = share * part.density_g_per_cm3 / density * weight
            moles[z] = moles.get(z, 0.0) + 100 * grams / xraylib.AtomicWeight(z)
    formula = "".join(f"{xraylib.AtomicNumberToSymbol(z)}{count:.5f}" for z, count in moles.items())
    return f"{formula}@{density:.6f}"


def _make_cylinder(half_x_mm: float, half_y_mm: float) -> trimesh.Trimesh:
    """Make an upright elliptical cylinder, 420 mm long; its section is a 192-gon with the area of the ellipse."""
    sides = 192
    same_area = np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))
    mesh = trimesh.creation.cylinder(radius=1.0, height=420.0, sections=sides)
    return mesh.apply_scale([half_x_mm * same_area, half_y_mm * same_area, 1.0])
