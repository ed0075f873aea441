"""Measures of femur and tibia as they are seen from in front, by the outlines that a parallel beam would show.

Bones are in the frame of the mean man's, before they stand: x medial, y posterior, z proximal, mm.
"""

import numpy as np

from ..anatomy.contours import envelope
from ..anatomy.solids import edges_of
from ..core.checks import Array
from ..geometry.mesh import Mesh
from .shape_measures import between, femur_width, tibia_width

# From one column of an outline to the next, and how many lie to either side of the middle.
_PITCH_MM, _COLUMNS = 0.5, 90
# An anteroposterior beam falls along the plateau, which slopes backwards by so much; the femur it meets level.
_SLOPE_DEG = 5.0
# Half the width in which the notch's roof, the spines and the eminence are sought; where condyles and plateaus are.
_ROOF_MM, _SPINES_MM, _EMINENCE_MM = 7.0, 15.0, 25.0
_CONDYLE_MM, _PLATEAU_MM = (12.0, 32.0), (15.0, 30.0)


def front_measures(bone: str, mesh: Mesh) -> dict[str, float]:
    """Measures of one bone, shares of its width; none of a patella.

    bone  femur | tibia | patella
    """
    if bone == "femur":
        return _femur(mesh)
    return _tibia(mesh) if bone == "tibia" else {}


def _femur(mesh: Mesh) -> dict[str, float]:
    x, lower = _outline(mesh, 0.0, -1.0)
    width = femur_width(mesh.vertices)
    base = np.mean([lower[between(side * x, *_CONDYLE_MM)].min() for side in (1, -1)])
    depth = float(lower[np.abs(x) < _ROOF_MM].max() - base)
    wide = _run_about(x, lower > base + depth / 2, 0.0)
    return {
        "notch's depth, from in front": depth / width,
        "notch's width at half its depth": wide / width,
        "notch's depth over that width": depth / wide,
    }


def _tibia(mesh: Mesh) -> dict[str, float]:
    x, upper = _outline(mesh, _SLOPE_DEG, 1.0)
    width = tibia_width(mesh.vertices)
    level = np.mean([np.median(upper[between(side * x, *_PLATEAU_MM)]) for side in (1, -1)])
    middle = np.abs(x) < _SPINES_MM
    high = x[(np.abs(x) < _EMINENCE_MM) & (upper > (upper[middle].max() + level) / 2)]
    return {
        "eminence's height, from in front": float(upper[middle].max() - level) / width,
        "eminence's width at half its height": float(np.ptp(high)) / width,
    }


def _outline(mesh: Mesh, falls_deg: float, way: float) -> tuple[Array, Array]:
    """(n,), (n,)  columns (x) and the outline's height at each, of the upper (way +1) or lower (-1) end of a bone

    falls_deg  of the beam, on its way from behind
    """
    angle = np.deg2rad(falls_deg)
    height = np.cos(angle) * mesh.vertices[:, 2] + np.sin(angle) * mesh.vertices[:, 1]
    seen = np.column_stack((-height, mesh.vertices[:, 0] / _PITCH_MM))
    rows = envelope(seen, edges_of(mesh.faces), -_COLUMNS, 2 * _COLUMNS + 1, -way)
    return np.linspace(-_COLUMNS, _COLUMNS, len(rows)) * _PITCH_MM, -rows


def _run_about(x: Array, inside: np.ndarray, place: float) -> float:
    """Length of the run of columns inside that holds a place."""
    at = int(np.abs(x - place).argmin())
    outside = np.flatnonzero(~inside)
    low, high = outside[outside < at].max(initial=0), outside[outside > at].min(initial=len(x) - 1)
    return float(x[high] - x[low])
