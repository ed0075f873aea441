"""Criteria of radiographic positioning guides for each view, measured on simulated knees.

Knees are sampled from the grade table ``population``, grades 0 to 2, and positioned exactly as each protocol
specifies, without acquisition variability. Lengths are in mm in the joint plane. No parameter is fitted to the
criteria.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...anatomy import BuiltKnee, build
from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...data.analysis.reference_table import load_reference_tables
from ...geometry.view import (
    View,
    magnification,
    project_points,
    resolve_view,
)
from ...model.knee import Knee
from ...model.protocol import load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...raycast import compute_silhouette
from ..raycasting.raycast_engines import Row

Mask = NDArray[np.bool_]
# Length of the fibular head, measured downwards from its tip, in mm.
_HEAD_MM = 20.0
# Maximum height of condyle points, in mm in the frame of the template femur.
_CONDYLE_MM = 20.0
# Minimum distance of condyle points from the midline of the femur, in mm in the frame of the template femur.
_ASIDE_MM = 8.0
# Protocols whose criteria are measured.
_VIEWS = ("ap_standing", "rosenberg", "lateral", "skyline")
# Bones whose silhouettes are measured.
_BONES = ("femur", "tibia", "fibula", "patella")


def measure_positioning_criteria(count: int, workers: int) -> list[Row]:
    """Measure every positioning criterion on sampled knees.

    Parameters
    ----------
    count : int
        Number of knees.
    workers : int
        Number of worker processes.

    Returns
    -------
    list of dict
        One row per criterion: view, requirement of the guide (``asked``), name of the measured quantity, and its mean,
        standard deviation, minimum (``least``) and maximum (``most``).
    """
    knees = [sample_knee(grade=k % 3, rng=np.random.default_rng(k), grade_table="population") for k in range(count)]
    measured = map_in_parallel(measure_knee_positioning, knees, shared={}, workers=workers)
    rows: list[Row] = []
    for name, criterion in load_reference_tables().criteria.items():
        values = np.array([one[name] for one in measured])
        numbers = {"mean": values.mean(), "sd": values.std(ddof=1), "least": values.min(), "most": values.max()}
        rows.append(
            {"view": criterion.view, "asked": criterion.requirement, "quantity": name}
            | {key: round(float(value), 2) for key, value in numbers.items()}
            | {"knees": count}
        )
    return rows


def measure_knee_positioning(knee: Knee) -> dict[str, float]:
    """Measure every positioning quantity on one knee.

    Parameters
    ----------
    knee : Knee
        Knee to build and project.

    Returns
    -------
    dict of str to float
        Quantities by name; the name suffix states the unit.
    """
    # For a lateral view, a radiographer rotates the leg until the condyles overlap, so the rotation of the knee is 0.
    turned = {"lateral": replace(knee, rotation_deg=0.0)}
    protocols = {name: load_protocol(name) for name in _VIEWS}
    built = {name: build(turned.get(name, knee), protocol) for name, protocol in protocols.items()}
    views = {name: resolve_view(protocol) for name, protocol in protocols.items()}
    ap, lateral, skyline = (_project_bones(built[name], views[name]) for name in ("ap_standing", "lateral", "skyline"))
    front, tunnel = (_project_landmarks(built[name], views[name]) for name in ("ap_standing", "rosenberg"))
    return {
        **_measure_ap_alignment(front, ap["patella"], views["ap_standing"]),
        "ap_head_under_tibia_percent": _fibular_head_overlap_percent(ap, views["ap_standing"]),
        "rosenberg_notch_over_ap": _notch_height_mm(tunnel, views["rosenberg"])
        / _notch_height_mm(front, views["ap_standing"]),
        "lateral_condyles_apart_mm": _condyle_offset_mm(built["lateral"], views["lateral"]),
        "lateral_head_under_tibia_percent": _fibular_head_overlap_percent(lateral, views["lateral"]),
        "lateral_patella_clear_mm": _clearance_mm(lateral["patella"], lateral["femur"], views["lateral"]),
        "skyline_patella_clear_mm": _clearance_mm(skyline["patella"], skyline["femur"], views["skyline"]),
    }


def _project_bones(built: BuiltKnee, view: View) -> dict[str, Mask]:
    """Project each bone to a (rows, cols) boolean silhouette."""
    return {one.name: compute_silhouette(one.mesh_arrays, view) for one in built.scene.surfaces if one.name in _BONES}


def _pixels_to_joint_mm(pixels: float, view: View) -> float:
    """Convert a length in pixels to mm in the joint plane."""
    return pixels * view.pixel_mm / magnification(view)


def _project_landmarks(built: BuiltKnee, view: View) -> dict[str, Array]:
    """Project each landmark to its (row, column) in pixels."""
    return {name: np.array(place) for name, place in built.compute_truth_in_view(view).landmarks_px.items()}


def _measure_ap_alignment(landmarks_px: dict[str, Array], patella: Mask, view: View) -> dict[str, float]:
    """Measure the offsets of the patella and of the intercondylar eminence on an AP view.

    The patella is compared with the midpoint of the epicondyles, and the eminence with the top of the notch.
    """
    ends = landmarks_px["medial_epicondyle"][1], landmarks_px["lateral_epicondyle"][1]
    off_px = np.argwhere(patella)[:, 1].mean() - np.mean(ends)
    eminence = (landmarks_px["medial_spine"] + landmarks_px["lateral_spine"]) / 2
    return {
        "ap_patella_off_middle_percent": float(100 * abs(off_px) / abs(ends[0] - ends[1])),
        "ap_eminence_off_notch_mm": _pixels_to_joint_mm(abs(float(eminence[1] - landmarks_px["notch_top"][1])), view),
    }


def _notch_height_mm(landmarks_px: dict[str, Array], view: View) -> float:
    """Measure the height of the notch top above the distal condyles, in mm in the joint plane."""
    condyles = (landmarks_px["femur_medial_condyle"] + landmarks_px["femur_lateral_condyle"]) / 2
    return _pixels_to_joint_mm(float(condyles[0] - landmarks_px["notch_top"][0]), view)


def _fibular_head_overlap_percent(bone_masks: dict[str, Mask], view: View) -> float:
    """Measure the percentage of the fibular-head silhouette that overlaps the tibia."""
    rows = np.flatnonzero(bone_masks["fibula"].any(axis=1))
    head = bone_masks["fibula"].copy()
    head[rows[0] + round(_HEAD_MM * magnification(view) / view.pixel_mm) :] = False
    return float(100 * (head & bone_masks["tibia"]).sum() / head.sum())


def _clearance_mm(mask: Mask, other_mask: Mask, view: View) -> float:
    """Measure the smallest distance between two silhouettes, in mm in the joint plane; 0 if they overlap."""
    return _pixels_to_joint_mm(float(ndimage.distance_transform_edt(~other_mask)[mask].min()), view)


def _condyle_offset_mm(built: BuiltKnee, view: View) -> float:
    """Measure the distance between the posterior outlines of the two condyles, in mm in the joint plane."""
    assembly = built.assembly
    points = assembly.femur.mesh.vertices
    columns = project_points(assembly.orient_points(assembly.outer_femur_vertices_mm()), view)[:, 1]
    # On the lateral view of a right knee, seen from medial, posterior is on the right; a left knee is mirrored.
    back = np.sign(columns @ (points[:, 1] - points[:, 1].mean()))
    backs = [
        (back * columns[(side * points[:, 0] > _ASIDE_MM) & (points[:, 2] < _CONDYLE_MM)]).max() for side in (+1, -1)
    ]
    return _pixels_to_joint_mm(abs(float(backs[0] - backs[1])), view)
