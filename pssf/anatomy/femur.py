"""Distal femur of a right knee: shaft, two condyles, epicondyles, trochlear groove and notch, blended.

In the frame of the bone at the mean man's size: x medial, y posterior, z = 0 at the condyles' distal end.
"""

import atexit
from functools import lru_cache

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import Condyle, FemurShape, Notch
from ..data.shapes import ShapeTable
from .implicit import Column, Field, blend, carve, ellipsoid, lengths, meet
from .mean_bone import MeanBone, mean_bone
from .solids import SHAFT_POWER, checked, column, hull, loft, thickness

# Cut flat here, outside the beam of any protocol in the package.
_END_MM = 285.0


@lru_cache(maxsize=4)
def mean_femur(shape: FemurShape, forms: ShapeTable) -> MeanBone:
    """The mean man's femur."""
    return mean_bone("femur", shape, field_of(shape), _shell, _rough, forms)


# manifold3d says on standard error what of it still stands when Python has ended.
atexit.register(mean_femur.cache_clear)


def field_of(shape: FemurShape) -> Field:
    """Points (n, 3) -> (n,)  approximate distance from the femur's outer surface, mm, negative inside"""
    shaft_field = Column(np.array(shape.sections), SHAFT_POWER)

    def field(points: Array) -> Array:
        end = shape.trochlea_end_z - shape.trochlea_end_bend * points[:, 0] ** 2
        shaft = meet(shaft_field(points), end - points[:, 2], shape.fillet_mm)
        whole = meet(shaft, points[:, 2] - _END_MM, 0.5)
        for condyle in (shape.condyles.medial, shape.condyles.lateral):
            whole = blend(whole, condyle_field(points, condyle), shape.fillet_mm)
        for part in shape.bumps:
            whole = blend(whole, ellipsoid(points, part.centre, part.half), part.fillet_mm)
        whole = carve(whole, notch_field(points, shape.notch), shape.notch.fillet_mm)
        for part in shape.hollows:
            whole = carve(whole, ellipsoid(points, part.centre, part.half), part.fillet_mm)
        return whole

    return field


def condyle_field(points: Array, condyle: Condyle) -> Array:
    """(n,)  approximate distance of points (n, 3), mm, from one condyle

    An oval in the sagittal plane carried across, thinning sideways.
    """
    offset = points - _centre(condyle)
    norm = _condyle_norm(offset, condyle)
    away = lengths(offset)
    return (norm - 1) * np.where(norm > 0.05, away / np.maximum(norm, 0.05), 15.0)


def _centre(condyle: Condyle) -> Array:
    return np.array([condyle.x, condyle.y, condyle.low_z + condyle.down])


def _condyle_norm(offset: Array, condyle: Condyle) -> Array:
    """(n,)  1 on the condyle's surface; offsets (n, 3) from its centre"""
    along = offset[:, 1] / np.where(offset[:, 1] > 0, condyle.back, condyle.front)
    beyond = offset[:, 0] * np.sign(condyle.x)
    height = offset[:, 2] - condyle.rise * np.maximum(beyond, 0.0)
    sagittal = np.hypot(along, height / np.where(height > 0, condyle.up, condyle.down))
    outward = beyond > 0
    across = np.abs(offset[:, 0]) / np.where(outward, condyle.outer, condyle.inner)
    power = np.where(outward, condyle.outer_power, condyle.inner_power)
    return np.asarray((across**power + sagittal**power) ** (1 / power))


def _notch_at(y_mm: Array, notch: Notch) -> tuple[Array, Array, Array]:
    """Height of the notch's roof, its curvature (1/mm) and half width at places y."""
    rows = np.array(notch.sections)
    roof, bend, half = (np.interp(y_mm, rows[:, 0], rows[:, k]) for k in (1, 2, 3))
    return roof, bend, half


def notch_field(points: Array, notch: Notch) -> Array:
    """(n,)  approximate distance of points (n, 3), mm, from the notch, negative within it"""
    roof, bend, half = _notch_at(points[:, 1], notch)
    across = points[:, 0]
    under = (points[:, 2] - roof + bend * across**2) / np.sqrt(1.29 + (2 * bend * across) ** 2)
    return meet(under, np.abs(across) - half - notch.flare * np.maximum(roof - points[:, 2], 0.0), 5.0)


def _shell(shape: FemurShape, points: Array, cortex: float, plate: float | Array) -> Array:
    """(n,)  thickness of cortex or plate at points (n, 3), mm; cortex and plate, of all or (n,), over the mean man's"""
    share = np.clip((shape.plate_below_z - points[:, 2]) / 4.0, 0.0, 1.0)
    share *= np.clip((shape.plate_within_x - np.abs(points[:, 0])) / 4.0, 0.0, 1.0)
    shell = (1 - share) * thickness(shape.cortex, cortex)(points[:, 2]) + share * shape.plate_mm * plate
    # The notch bears no weight: its walls are thin, and pass into the condyles' plate over 3 mm.
    within = np.clip(1 - notch_field(points, shape.notch) / 3.0, 0.0, 1.0)
    return np.asarray(shell + within * (shape.notch.cortex_mm * cortex - shell))


def _rough(shape: FemurShape) -> Manifold:
    """The same parts by CSG, with hard creases."""
    sections = np.array(shape.sections)
    heights = np.concatenate((np.arange(sections[:, 0].min(), 70.0, 2.5), np.linspace(70.0, _END_MM, 54)))
    solid = column(sections, np.zeros_like, heights, "femur shaft", count=72)
    for side in ("medial", "lateral"):
        solid += _rough_condyle(getattr(shape.condyles, side), side)
    return checked(solid - _rough_notch(shape.notch), "femur")


def _rough_condyle(condyle: Condyle, side: str) -> Manifold:
    turn = np.arange(1500) * np.pi * (3 - np.sqrt(5))
    height = np.linspace(-1, 1, 1500)
    ways = np.column_stack((np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height))
    return hull(_centre(condyle) + ways / _condyle_norm(ways, condyle)[:, None], f"femur {side} condyle")


def _rough_notch(notch: Notch) -> Manifold:
    rings = []
    for y in np.linspace(45.0, -24.0, 9):
        roof, bend, half = _notch_at(np.array(y), notch)
        across = np.linspace(half, -half, 25)
        arch = np.column_stack((across, np.full(25, y), roof - bend * across**2))
        foot = half + notch.flare * (roof + 30.0)
        rings.append(np.vstack(([[-foot, y, -30.0], [foot, y, -30.0]], arch)))
    return loft(np.array(rings), "femur notch")
