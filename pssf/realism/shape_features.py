"""Features of the contours of a film in standard form, in four groups: joint space, contour, margins, shape."""

import numpy as np

from ..anatomy.truth import FRACTIONS
from ..core.checks import Array
from .form import PITCH_MM
from .outline import Outline

# Places across the plateau, as shares of its width from its middle; medial is positive.
_STATIONS = np.round(np.linspace(-0.42, 0.42, 15), 2)
_NOTCH, _SPINES = 0.14, 0.16  # half width in which the notch's top and the spines are looked for
_EDGE_MM = (3.0, 8.0)  # below the contour, where the plateau is widest
_MARGIN_MM = (4.0, 8.0, 12.0, 18.0)  # from the joint, where the sides of the bones are told
_MEDIAL_BAND, _LATERAL_BAND = (0.1, 0.3), (0.7, 0.9)  # of the plateau's width from its medial edge

Features = dict[str, float]


def plateau_edges(outline: Outline) -> tuple[float, float]:
    """Columns of the lateral and medial edge of the plateau, where the tibia is widest just below the joint."""
    heights = (outline.tibia_rows - outline.tibia_rows[0]) * PITCH_MM + 3.0
    near = (heights >= _EDGE_MM[0]) & (heights <= _EDGE_MM[1])
    lateral, medial = outline.tibia_sides[near].T
    return float(np.median(lateral)), float(np.median(medial))


def plateau_shares(outline: Outline) -> Array:
    """(n,)  places of an outline's columns across the plateau, as shares of its width from its middle"""
    left, right = plateau_edges(outline)
    return np.asarray((outline.columns - (left + right) / 2) / (right - left))


def shape_groups(outline: Outline) -> dict[str, Features]:
    """Group -> feature -> value. Lengths are shares of the plateau's width, so that no pitch is needed."""
    left, right = plateau_edges(outline)
    width, share = right - left, plateau_shares(outline)
    tilt = _tilt(outline, share, width)
    tibia, femur = ((tilt * share - row / width) for row in (outline.tibia, outline.femur))
    level = np.mean([np.interp(at, share, tibia) for at in (-0.4, 0.4)])
    tibia, femur = tibia - level, femur - level
    contour = {f"femur_{at:+.2f}": float(np.interp(at, share, femur)) for at in _STATIONS}
    contour |= {f"tibia_{at:+.2f}": float(np.interp(at, share, tibia)) for at in _STATIONS}
    return {
        "joint space": _joint_space(share, femur - tibia),
        "contour": contour,
        "margins": _margins(outline, (left, right)),
        "shape": _shape(outline, share, femur, tibia),
    }


def _tilt(outline: Outline, share: Array, width: float) -> float:
    """Rise of the rows, as a share of the width, over the whole width: between four tenths of it to either side."""
    lateral, medial = (np.interp(at, share, outline.tibia) for at in (-0.4, 0.4))
    return float((medial - lateral) / 0.8 / width)


def _joint_space(share: Array, gap: Array) -> Features:
    """Widths at the fractions of JSW(x), the least of each compartment, their ratio and how the lines converge."""
    from_medial = 0.5 - share
    space = {f"at_{at:.3f}": float(np.interp(0.5 - at, share, gap)) for at in FRACTIONS}
    least = {}
    for name, (low, high) in (("medial", _MEDIAL_BAND), ("lateral", _LATERAL_BAND)):
        inside = (from_medial >= low) & (from_medial <= high)
        least[f"{name}_least"] = float(gap[inside].min())
        least[f"{name}_mean"] = float(gap[inside].mean())
    least["least"] = min(least["medial_least"], least["lateral_least"])
    least["medial_less_lateral"] = least["medial_mean"] - least["lateral_mean"]
    return space | least


def _margins(outline: Outline, edges: tuple[float, float]) -> Features:
    """How far each bone stands out beside the plateau's edge at heights from the joint, and beyond its own flank."""
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


def _shape(outline: Outline, share: Array, femur: Array, tibia: Array) -> Features:
    """Notch, spines, condyles and the width of the bones, as shares of the plateau's width."""
    left, right = plateau_edges(outline)
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
        "notch_at": float(notch_at),
        "condyles_differ": lowest["medial"] - lowest["lateral"],
        "medial_spine": spines["medial"][0],
        "lateral_spine": spines["lateral"][0],
        "spines_apart": spines["medial"][1] - spines["lateral"][1],
        "medial_dish": float(np.interp(0.25, share, tibia)),
        "lateral_dish": float(np.interp(-0.25, share, tibia)),
        "metaphysis_width": float(narrow),
        "femur_width": float(broad),
    }
