"""Proximal tibia of a right knee: a flaring shaft under a plateau with two spines, and the tuberosity, blended.

In the frame of the bone at the mean man's size: x medial, y posterior, z = 0 at the middle of a level plateau.
"""

from functools import cache

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data import tables
from .implicit import Column, blend, ellipsoid, meet, shaped
from .solids import checked, column, height_field

_POWER = 2.3
_END_MM = -285.0


def field(points: Array) -> Array:
    """(n,)  approximate distance from the tibia's outer surface at points (n, 3), mm, negative inside"""
    table = tables.data("anatomy")["tibia"]
    shape = meet(_shaft()(_evenly_deep(points)), _END_MM - points[:, 2], 0.5)
    for part in table["bumps"]:
        shape = blend(shape, ellipsoid(points, part["centre"], part["half"]), part["fillet_mm"])
    return meet(shape, above(points), table["rim_mm"])


def above(points: Array) -> Array:
    """(n,)  approximate distance of points (n, 3) above the plateau's relief, mm"""
    height, slope_x, slope_y = _relief(points[:, 0], points[:, 1])
    return (points[:, 2] - height) / np.sqrt(1 + slope_x**2 + slope_y**2)


@cache
def outer(tolerance_mm: float | None = None) -> Manifold:
    """The tibia's outer solid with a level plateau and a straight shaft.

    tolerance_mm  how far middles of edges may be off the surface; that of `data/anatomy.toml` if None
    """
    table = tables.data("anatomy")["tibia"]
    return checked(shaped(_rough(), field, table["edge_mm"], tolerance_mm or table["tolerance_mm"]), "tibia")


@cache
def _shaft() -> Column:
    return Column(np.array(tables.data("anatomy")["tibia"]["sections"]), _POWER)


def _evenly_deep(points: Array) -> Array:
    """(n, 3)  points moved to where they would be if both sides of the plateau were as deep as its middle"""
    table = tables.data("anatomy")["tibia"]
    fade = np.clip(1 - points[:, 2] / table["deeper_above_z"], 0.0, 1.0) ** 2
    places = points.copy()
    places[:, 1] /= 1 + np.clip(table["deeper_medially"] * points[:, 0], -0.15, 0.15) * fade
    return places


def _relief(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Height of the plateau and its slopes along x and y: a sum of bells, negative ones for the dishes."""
    height, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    for bell in tables.data("anatomy")["tibia"]["relief"]:
        u, v = (x - bell["x"]) / bell["half_x"], (y - bell["y"]) / bell["half_y"]
        part = bell["height"] * np.exp(-(u**2) - v**2)
        height += part
        slope_x -= 2 * u / bell["half_x"] * part
        slope_y -= 2 * v / bell["half_y"] * part
    return height, slope_x, slope_y


def _rough() -> Manifold:
    """The same parts by CSG, with hard creases."""
    sections = np.array(tables.data("anatomy")["tibia"]["sections"])
    heights = np.concatenate((np.linspace(_END_MM, -60.0, 56), np.arange(-57.5, sections[:, 0].max(), 2.5)))
    shaft = column(sections, np.zeros_like, heights, "tibia shaft", power=_POWER, count=72)
    for part in tables.data("anatomy")["tibia"]["bumps"]:
        shaft += Manifold.sphere(1.0, 48).scale(part["half"]).translate(part["centre"])
    x, y = np.linspace(-45, 45, 61), np.linspace(-36, 32, 46)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    top = _relief(gx.ravel(), gy.ravel())[0].reshape(gx.shape)
    return checked(shaft ^ height_field(x, y, top, _END_MM - 10.0, "tibial plateau"), "tibia")
