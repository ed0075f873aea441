"""Distal femur of a right knee: shaft, two condyles, epicondyles, trochlear groove and notch, blended.

In the frame of the bone at the mean man's size: x medial, y posterior, z = 0 at the condyles' distal end.
"""

from functools import cache

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data import tables
from .implicit import Column, blend, carve, ellipsoid, lengths, meet, shaped
from .solids import checked, column, hull, loft

_POWER = 2.3
# Cut flat here, outside the beam of any protocol in the package.
_END_MM = 285.0


def field(points: Array) -> Array:
    """(n,)  approximate distance from the femur's outer surface at points (n, 3), mm, negative inside"""
    table = tables.data("anatomy")["femur"]
    end = table["trochlea_end_z"] - table["trochlea_end_bend"] * points[:, 0] ** 2
    shaft = meet(_shaft()(points), end - points[:, 2], table["fillet_mm"])
    shape = meet(shaft, points[:, 2] - _END_MM, 0.5)
    for side in ("medial", "lateral"):
        shape = blend(shape, condyle_field(points, side), table["fillet_mm"])
    for part in table["bumps"]:
        shape = blend(shape, ellipsoid(points, part["centre"], part["half"]), part["fillet_mm"])
    shape = carve(shape, _notch_field(points), table["notch"]["fillet_mm"])
    for part in table["hollows"]:
        shape = carve(shape, ellipsoid(points, part["centre"], part["half"]), part["fillet_mm"])
    return shape


@cache
def outer(tolerance_mm: float | None = None) -> Manifold:
    """The femur's outer solid with a straight shaft.

    tolerance_mm  how far middles of edges may be off the surface; that of `data/anatomy.toml` if None
    """
    table = tables.data("anatomy")["femur"]
    return checked(shaped(_rough(), field, table["edge_mm"], tolerance_mm or table["tolerance_mm"]), "femur")


def condyle_field(points: Array, side: str) -> Array:
    """(n,)  approximate distance from one condyle: an oval in the sagittal plane carried across, thinning sideways"""
    centre = _centre(side)
    offset = points - centre
    norm = _condyle_norm(offset, side)
    away = lengths(offset)
    return (norm - 1) * np.where(norm > 0.05, away / np.maximum(norm, 0.05), 15.0)


@cache
def _shaft() -> Column:
    return Column(np.array(tables.data("anatomy")["femur"]["sections"]), _POWER)


def _centre(side: str) -> Array:
    part = tables.data("anatomy")["condyles"][side]
    return np.array([part["x"], part["y"], part["down"]])


def _condyle_norm(offset: Array, side: str) -> Array:
    """(n,)  1 on the condyle's surface; offsets (n, 3) from its centre"""
    part = tables.data("anatomy")["condyles"][side]
    along = offset[:, 1] / np.where(offset[:, 1] > 0, part["back"], part["front"])
    sagittal = np.hypot(along, offset[:, 2] / np.where(offset[:, 2] > 0, part["up"], part["down"]))
    outward = offset[:, 0] * np.sign(part["x"]) > 0
    across = np.abs(offset[:, 0]) / np.where(outward, part["outer"], part["inner"])
    power = np.where(outward, part["outer_power"], part["inner_power"])
    return np.asarray((across**power + sagittal**power) ** (1 / power))


def _notch_at(y_mm: Array) -> tuple[Array, Array, Array]:
    """Height of the notch's roof, its curvature (1/mm) and half width at places y."""
    rows = np.array(tables.data("anatomy")["femur"]["notch"]["sections"])
    roof, bend, half = (np.interp(y_mm, rows[:, 0], rows[:, k]) for k in (1, 2, 3))
    return roof, bend, half


def _notch_field(points: Array) -> Array:
    roof, bend, half = _notch_at(points[:, 1])
    across = points[:, 0]
    under = (points[:, 2] - roof + bend * across**2) / np.sqrt(1.29 + (2 * bend * across) ** 2)
    return meet(under, np.abs(across) - half - _flare() * np.maximum(roof - points[:, 2], 0.0), 5.0)


def _flare() -> float:
    return float(tables.data("anatomy")["femur"]["notch"]["flare"])


def _rough() -> Manifold:
    """The same parts by CSG, with hard creases."""
    sections = np.array(tables.data("anatomy")["femur"]["sections"])
    heights = np.concatenate((np.arange(sections[:, 0].min(), 70.0, 2.5), np.linspace(70.0, _END_MM, 54)))
    solid = column(sections, np.zeros_like, heights, "femur shaft", power=_POWER, count=72)
    for side in ("medial", "lateral"):
        solid += _rough_condyle(side)
    return checked(solid - _rough_notch(), "femur")


def _rough_condyle(side: str) -> Manifold:
    turn = np.arange(1500) * np.pi * (3 - np.sqrt(5))
    height = np.linspace(-1, 1, 1500)
    ways = np.column_stack((np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height))
    return hull(_centre(side) + ways / _condyle_norm(ways, side)[:, None], f"femur {side} condyle")


def _rough_notch() -> Manifold:
    rings = []
    for y in np.linspace(45.0, -24.0, 9):
        roof, bend, half = _notch_at(np.array(y))
        across = np.linspace(half, -half, 25)
        arch = np.column_stack((across, np.full(25, y), roof - bend * across**2))
        foot = half + _flare() * (roof + 30.0)
        rings.append(np.vstack(([[-foot, y, -30.0], [foot, y, -30.0]], arch)))
    return loft(np.array(rings), "femur notch")
