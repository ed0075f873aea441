"""Proximal tibia of a right knee: a flaring shaft under a plateau with two spines, and the tuberosity, blended.

In the frame of the bone at the mean man's size: x medial, y posterior, z = 0 at the middle of a level plateau.
"""

import atexit
from functools import lru_cache

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import Bell, TibiaShape
from ..data.shapes import ShapeTable
from .implicit import Column, Field, blend, ellipsoid, meet
from .mean_bone import MeanBone, mean_bone
from .solids import SHAFT_POWER, checked, column, height_field, thickness

_END_MM = -285.0


@lru_cache(maxsize=4)
def mean_tibia(shape: TibiaShape, forms: ShapeTable) -> MeanBone:
    """The mean man's tibia, with a level plateau."""
    return mean_bone("tibia", shape, field_of(shape), _shell, _rough, forms)


# manifold3d says on standard error what of it still stands when Python has ended.
atexit.register(mean_tibia.cache_clear)


def field_of(shape: TibiaShape) -> Field:
    """Points (n, 3) -> (n,)  approximate distance from the tibia's outer surface, mm, negative inside"""
    shaft_field = Column(np.array(shape.sections), SHAFT_POWER)

    def field(points: Array) -> Array:
        whole = meet(shaft_field(_evenly_deep(points, shape)), _END_MM - points[:, 2], 0.5)
        for part in shape.bumps:
            whole = blend(whole, ellipsoid(points, part.centre, part.half), part.fillet_mm)
        far = np.minimum(np.abs(points[:, 1]) / shape.far_rim_y, 1.0) ** 2
        rim_mm = shape.rim_mm + far * (shape.far_rim_mm - shape.rim_mm)
        return meet(whole, above(points, shape.relief), rim_mm)

    return field


def above(points: Array, relief: tuple[Bell, ...]) -> Array:
    """(n,)  approximate distance of points (n, 3) above the plateau's relief, mm"""
    height, slope_x, slope_y = _relief(points[:, 0], points[:, 1], relief)
    return (points[:, 2] - height) / np.sqrt(1 + slope_x**2 + slope_y**2)


def plateau_height(x: Array, y: Array, relief: tuple[Bell, ...]) -> Array:
    """(n,)  height of a level plateau's surface at places x and y (n,), mm"""
    return _relief(x, y, relief)[0]


def _evenly_deep(points: Array, shape: TibiaShape) -> Array:
    """(n, 3)  points moved to where they would be if both sides of the plateau were as deep as its middle"""
    fade = np.clip(1 - points[:, 2] / shape.deeper_above_z, 0.0, 1.0) ** 2
    places = points.copy()
    places[:, 1] /= 1 + np.clip(shape.deeper_medially * points[:, 0], -0.15, 0.15) * fade
    return places


def _relief(x: Array, y: Array, relief: tuple[Bell, ...]) -> tuple[Array, Array, Array]:
    """Height of the plateau and its slopes along x and y: a sum of bells, negative ones for the dishes."""
    height, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    for bell in relief:
        u, v = (x - bell.x) / bell.half_x, (y - bell.y) / bell.half_y
        part = bell.height * np.exp(-(u**2) - v**2)
        height += part
        slope_x -= 2 * u / bell.half_x * part
        slope_y -= 2 * v / bell.half_y * part
    return height, slope_x, slope_y


def _shell(shape: TibiaShape, points: Array, cortex: float, plate: float | Array) -> Array:
    """(n,)  thickness of cortex or plate at points (n, 3), mm; cortex and plate, of all or (n,), over the mean man's"""
    # The plate under the cartilage passes into the cortex of the sides over its own first millimetres.
    share = np.clip(1 + above(points, shape.relief) / 3.0, 0.0, 1.0)
    plates = shape.plate_mm + plateau_height(points[:, 0], points[:, 1], shape.plates)
    return np.asarray((1 - share) * thickness(shape.cortex, cortex)(points[:, 2]) + share * plates * plate)


def _rough(shape: TibiaShape) -> Manifold:
    """The same parts by CSG, with hard creases."""
    sections = np.array(shape.sections)
    heights = np.concatenate((np.linspace(_END_MM, -60.0, 56), np.arange(-57.5, sections[:, 0].max(), 2.5)))
    shaft = column(sections, np.zeros_like, heights, "tibia shaft", count=72)
    for part in shape.bumps:
        shaft += Manifold.sphere(1.0, 48).scale(part.half).translate(part.centre)
    x, y = np.linspace(-45, 45, 61), np.linspace(-36, 32, 46)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    top = plateau_height(gx.ravel(), gy.ravel(), shape.relief).reshape(gx.shape)
    return checked(shaft ^ height_field(x, y, top, _END_MM - 10.0, "tibial plateau"), "tibia")
