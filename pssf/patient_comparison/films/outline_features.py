"""Measure contour features of a normalised radiograph: joint space, contour, margins and bone shape."""

import numpy as np

from ...core.checks import Array
from ...core.label_names import JSW_FRACTIONS
from .film_normalisation import PITCH_MM
from .film_outline import Outline

# Positions of contour height measurements: distance from the plateau middle in plateau widths, positive medially.
_STATION_FRACTIONS = np.round(np.linspace(-0.42, 0.42, 15), 2)
# Distance from the plateau middle within which the top of the notch is searched for, in plateau widths.
_NOTCH = 0.14
# Distance from the plateau middle within which the tibial spines are searched for, in plateau widths.
_SPINES = 0.16
# Depth range below the tibial contour in which the plateau edges are searched for, in mm.
_EDGE_MM = (3.0, 8.0)
# Distances from the joint at which bone margins are measured, in mm.
_MARGIN_MM = (4.0, 8.0, 12.0, 18.0)
# Range of the medial compartment, as fractions of the plateau width from the medial edge.
_MEDIAL_BAND = (0.1, 0.3)
# Range of the lateral compartment, as fractions of the plateau width from the medial edge.
_LATERAL_BAND = (0.7, 0.9)

Features = dict[str, float]


def find_plateau_edges(outline: Outline) -> tuple[float, float]:
    """Find the lateral and medial plateau edges, where the tibia is widest just below the joint.

    Parameters
    ----------
    outline : Outline
        Bone contours.

    Returns
    -------
    tuple of float
        Columns of the lateral and medial plateau edges, in px.
    """
    heights = (outline.tibia_rows - outline.tibia_rows[0]) * PITCH_MM + 3.0
    near = (heights >= _EDGE_MM[0]) & (heights <= _EDGE_MM[1])
    lateral, medial = outline.tibia_sides[near].T
    return float(np.median(lateral)), float(np.median(medial))


def plateau_fractions(outline: Outline) -> Array:
    """Convert the columns of an outline to distances from the plateau middle, in plateau widths.

    Parameters
    ----------
    outline : Outline
        Bone contours.

    Returns
    -------
    (n,) array
        Distance of each column from the plateau middle, in plateau widths; positive medially.
    """
    left, right = find_plateau_edges(outline)
    return np.asarray((outline.columns - (left + right) / 2) / (right - left))


def measure_shape_features(outline: Outline) -> dict[str, Features]:
    """Measure the contour features; lengths are fractions of the plateau width and require no pixel pitch.

    Parameters
    ----------
    outline : Outline
        Bone contours.

    Returns
    -------
    dict of str to dict of str to float
        Features keyed by group and by name.
    """
    left, right = find_plateau_edges(outline)
    width, share = right - left, plateau_fractions(outline)
    tilt = _plateau_tilt(outline, share, width)
    tibia, femur = ((tilt * share - row / width) for row in (outline.tibia, outline.femur))
    level = np.mean([np.interp(at, share, tibia) for at in (-0.4, 0.4)])
    tibia, femur = tibia - level, femur - level
    contour = {f"femur_{at:+.2f}": float(np.interp(at, share, femur)) for at in _STATION_FRACTIONS}
    contour |= {f"tibia_{at:+.2f}": float(np.interp(at, share, tibia)) for at in _STATION_FRACTIONS}
    return {
        "joint space": _measure_joint_space(share, femur - tibia),
        "contour": contour,
        "margins": _measure_margins(outline, (left, right)),
        "shape": _measure_shape(outline, share, femur, tibia),
    }


def _plateau_tilt(outline: Outline, share: Array, width: float) -> float:
    """Measure the plateau tilt between points 0.4 plateau widths lateral and medial of the middle, dimensionless."""
    lateral, medial = (np.interp(at, share, outline.tibia) for at in (-0.4, 0.4))
    return float((medial - lateral) / 0.8 / width)


def _measure_joint_space(share: Array, gap: Array) -> Features:
    """Measure the joint space at fixed positions (JSW(x)), and its minimum and mean in each compartment.

    `share` contains the column positions, and `gap` the joint space heights, both in plateau widths.
    """
    from_medial = 0.5 - share
    space = {f"at_{at:.3f}": float(np.interp(0.5 - at, share, gap)) for at in JSW_FRACTIONS}
    summary = {}
    for name, (low, high) in (("medial", _MEDIAL_BAND), ("lateral", _LATERAL_BAND)):
        inside = (from_medial >= low) & (from_medial <= high)
        summary[f"{name}_min"] = float(gap[inside].min())
        summary[f"{name}_mean"] = float(gap[inside].mean())
    summary["min"] = min(summary["medial_min"], summary["lateral_min"])
    summary["medial_minus_lateral"] = summary["medial_mean"] - summary["lateral_mean"]
    return space | summary


def _measure_margins(outline: Outline, edges: tuple[float, float]) -> Features:
    """Measure bone margin overhang relative to the plateau edge and to the margin 10 to 16 mm from the joint."""
    width = edges[1] - edges[0]
    values = {}
    for bone, rows, sides in (
        ("tibia", outline.tibia_rows, outline.tibia_sides),
        ("femur", outline.femur_rows, outline.femur_sides),
    ):
        heights = np.abs(rows - rows[0]) * PITCH_MM + 3.0
        for index, (name, way) in enumerate((("lateral", -1), ("medial", 1))):
            out = way * (sides[:, index] - edges[index]) / width
            for height in _MARGIN_MM:
                values[f"{name}_{bone}_{height:g}mm"] = float(np.interp(height, heights, out))
            values[f"{name}_{bone}_lip"] = float(
                out[heights < 8].max() - np.median(out[(heights > 10) & (heights < 16)])
            )
    return values


def _measure_shape(outline: Outline, share: Array, femur: Array, tibia: Array) -> Features:
    """Measure notch, spines, condyles and bone widths as fractions of the plateau width."""
    left, right = find_plateau_edges(outline)
    middle = np.abs(share) < _NOTCH
    notch_at = share[middle][femur[middle].argmax()]
    lowest = {name: float(femur[part].min()) for name, part in (("lateral", share < -0.15), ("medial", share > 0.15))}
    top, base = float(femur[middle].max()), sum(lowest.values()) / 2
    half = share[femur > (top + base) / 2]
    spines = {
        name: (float(tibia[part].max()), float(share[part][tibia[part].argmax()]))
        for name, part in (
            ("lateral", (share > -_SPINES) & (share < 0.01)),
            ("medial", (share > 0.01) & (share < _SPINES)),
        )
    }
    narrow = np.diff(outline.tibia_sides[-5:], axis=1).mean() / (right - left)
    broad = np.diff(outline.femur_sides, axis=1).max() / (right - left)
    return {
        "notch_depth": top - base,
        "notch_width": float(half[-1] - half[0]) if len(half) else 0.0,
        "notch_position": float(notch_at),
        "condyle_height_difference": lowest["medial"] - lowest["lateral"],
        "medial_spine": spines["medial"][0],
        "lateral_spine": spines["lateral"][0],
        "spine_distance": spines["medial"][1] - spines["lateral"][1],
        "medial_plateau_depth": float(np.interp(0.25, share, tibia)),
        "lateral_plateau_depth": float(np.interp(-0.25, share, tibia)),
        "metaphysis_width": float(narrow),
        "femur_width": float(broad),
    }
