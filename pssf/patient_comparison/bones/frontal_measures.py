"""Compute shape measures of femur and tibia from their frontal outlines in parallel projection.

Bones are in the frame of the template bone, before posture is applied: x medial, y posterior, z proximal, in mm.
"""

import numpy as np

from ...anatomy.meshing.solids import find_edges
from ...anatomy.outlines.projected_contours import compute_outline_rows
from ...core.checks import Array
from ...geometry.mesh import Mesh
from .shape_measures import femur_width_mm, is_between, tibia_width_mm

# Distance between neighbouring columns of an outline, in mm.
_PITCH_MM = 0.5
# Number of outline columns on each side of the midline.
_COLUMNS = 90
# Posterior slope of the tibial plateau, in degrees. The tibia is projected parallel to the plateau, and the femur
# horizontally.
_SLOPE_DEG = 5.0
# Distance from the midline within which the roof of the intercondylar notch is searched for, in mm.
_ROOF_MM = 7.0
# Distance from the midline within which the tibial spines are searched for, in mm.
_SPINES_MM = 15.0
# Distance from the midline within which the eminence is searched for, in mm.
_EMINENCE_MM = 25.0
# Range of distances of the condyles from the midline, in mm.
_CONDYLE_MM = (12.0, 32.0)
# Range of distances of the plateaus from the midline, in mm.
_PLATEAU_MM = (15.0, 30.0)


def measure_front_view(bone: str, mesh: Mesh) -> dict[str, float]:
    """Measure the frontal outline of a femur or tibia; a patella has no frontal measures.

    Parameters
    ----------
    bone : {"femur", "tibia", "patella"}
        Bone type.
    mesh : Mesh
        Surface of the bone, in mm.

    Returns
    -------
    dict of str to float
        Lengths as fractions of the bone width; empty for a patella.
    """
    if bone == "femur":
        return _measure_femur(mesh)
    return _measure_tibia(mesh) if bone == "tibia" else {}


def _measure_femur(mesh: Mesh) -> dict[str, float]:
    """Measure depth and width of the intercondylar notch."""
    x, lower = _project_outline(mesh, 0.0, -1.0)
    width = femur_width_mm(mesh.vertices)
    base = np.mean([lower[is_between(side * x, *_CONDYLE_MM)].min() for side in (1, -1)])
    depth = float(lower[np.abs(x) < _ROOF_MM].max() - base)
    wide = _run_length_around(x, lower > base + depth / 2, 0.0)
    return {
        "notch's depth, from in front": depth / width,
        "notch's width at half its depth": wide / width,
        "ratio of notch depth to notch width": depth / wide,
    }


def _measure_tibia(mesh: Mesh) -> dict[str, float]:
    """Measure height and width of the intercondylar eminence."""
    x, upper = _project_outline(mesh, _SLOPE_DEG, 1.0)
    width = tibia_width_mm(mesh.vertices)
    level = np.mean([np.median(upper[is_between(side * x, *_PLATEAU_MM)]) for side in (1, -1)])
    middle = np.abs(x) < _SPINES_MM
    high = x[(np.abs(x) < _EMINENCE_MM) & (upper > (upper[middle].max() + level) / 2)]
    return {
        "eminence's height, from in front": float(upper[middle].max() - level) / width,
        "eminence's width at half its height": float(np.ptp(high)) / width,
    }


def _project_outline(mesh: Mesh, slope_deg: float, end_sign: float) -> tuple[Array, Array]:
    """Compute the projected distal (`end_sign` -1) or proximal (+1) outline of a bone.

    `slope_deg` is the slope of the projection direction. Return column positions (n,) and heights (n,), in mm.
    """
    angle = np.deg2rad(slope_deg)
    height = np.cos(angle) * mesh.vertices[:, 2] + np.sin(angle) * mesh.vertices[:, 1]
    seen = np.column_stack((-height, mesh.vertices[:, 0] / _PITCH_MM))
    rows = compute_outline_rows(seen, find_edges(mesh.faces), -_COLUMNS, 2 * _COLUMNS + 1, -end_sign)
    return np.linspace(-_COLUMNS, _COLUMNS, len(rows)) * _PITCH_MM, -rows


def _run_length_around(x: Array, inside: np.ndarray, place: float) -> float:
    """Measure the length of the run of true values in `inside` that contains the position `place`, in mm."""
    at = int(np.abs(x - place).argmin())
    outside = np.flatnonzero(~inside)
    low, high = outside[outside < at].max(initial=0), outside[outside > at].min(initial=len(x) - 1)
    return float(x[high] - x[low])
