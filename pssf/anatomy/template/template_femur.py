"""Distal femur of a right knee: shaft, two condyles, epicondyles, trochlear groove and notch, blended with fillets.

Coordinates are in mm at template size: x medial, y posterior, z proximal, and z = 0 at the distal end of the condyles.
"""

import atexit
from functools import lru_cache

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array
from ...data.anatomy.bone_tables import Condyle, FemurShape, NotchShape
from ...data.anatomy.shape_table import ShapeModel
from ..meshing.implicit_shapes import (
    ColumnField,
    ScalarField,
    ellipsoid_distance_mm,
    lengths,
    smooth_difference,
    smooth_intersection,
    smooth_union,
)
from ..meshing.solids import (
    SHAFT_POWER,
    build_hull,
    loft,
    loft_column,
    make_thickness_profile,
    require_valid_solid,
)
from .template_bone import TemplateBone, make_template_bone

# Height at which the shaft ends in a flat cut, in mm. The cut is outside the beam of every protocol in the package.
_SHAFT_CUT_Z_MM = 285.0


@lru_cache(maxsize=4)
def make_template_femur(shape: FemurShape, forms: ShapeModel) -> TemplateBone:
    """Make the template femur.

    Parameters
    ----------
    shape : FemurShape
        Shape parameters of the femur.
    forms : ShapeModel
        Statistical shape model. Edges are made short enough for its deformations.

    Returns
    -------
    TemplateBone
        Template femur. Equal arguments return the same object.
    """
    return make_template_bone(
        "femur", shape, make_distance_field(shape), _compute_shell_thickness_mm, _build_csg_solid, forms
    )


# When Python exits, manifold3d writes a message to standard error if solids still exist. Clearing the cache prevents
# this message.
atexit.register(make_template_femur.cache_clear)


def make_distance_field(shape: FemurShape) -> ScalarField:
    """Make the distance field of the outer surface of the femur.

    Parameters
    ----------
    shape : FemurShape
        Shape parameters of the femur.

    Returns
    -------
    callable
        Function that maps points (n, 3), in mm, to approximate signed distances (n,), in mm, negative inside.
    """
    shaft_field = ColumnField(np.array(shape.sections), SHAFT_POWER)

    def field(points: Array) -> Array:
        end = shape.trochlea_end_z - shape.trochlea_end_bend * points[:, 0] ** 2
        shaft = smooth_intersection(shaft_field(points), end - points[:, 2], shape.fillet_mm)
        whole = smooth_intersection(shaft, points[:, 2] - _SHAFT_CUT_Z_MM, 0.5)
        for condyle in (shape.condyles.medial, shape.condyles.lateral):
            whole = smooth_union(whole, condyle_distance_mm(points, condyle), shape.fillet_mm)
        for part in shape.bumps:
            whole = smooth_union(whole, ellipsoid_distance_mm(points, part.centre, part.half), part.fillet_mm)
        whole = smooth_difference(whole, notch_distance_mm(points, shape.notch), shape.notch.fillet_mm)
        for part in shape.hollows:
            whole = smooth_difference(whole, ellipsoid_distance_mm(points, part.centre, part.half), part.fillet_mm)
        return whole

    return field


def condyle_distance_mm(points: Array, condyle: Condyle) -> Array:
    """Compute the approximate signed distance of points from one condyle.

    The condyle is an oval in the sagittal plane. It is extended in the medio-lateral direction and tapers towards both
    ends.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points in the frame of the femur.
    condyle : Condyle
        Shape parameters of the condyle.

    Returns
    -------
    (n,) float64 array
        Distance in mm, negative inside.
    """
    offset = points - _condyle_centre(condyle)
    norm = _condyle_norm(offset, condyle)
    away = lengths(offset)
    return (norm - 1) * np.where(norm > 0.05, away / np.maximum(norm, 0.05), 15.0)


def _condyle_centre(condyle: Condyle) -> Array:
    """Return the centre (3,) of a condyle, mm."""
    return np.array([condyle.x, condyle.y, condyle.low_z + condyle.down])


def _condyle_norm(offset: Array, condyle: Condyle) -> Array:
    """Compute the normalised distance (n,) of offsets (n, 3) from the centre of a condyle; it is 1 on the surface."""
    along = offset[:, 1] / np.where(offset[:, 1] > 0, condyle.back, condyle.front)
    beyond = offset[:, 0] * np.sign(condyle.x)
    height = offset[:, 2] - condyle.rise * np.maximum(beyond, 0.0)
    sagittal = np.hypot(along, height / np.where(height > 0, condyle.up, condyle.down))
    outward = beyond > 0
    across = np.abs(offset[:, 0]) / np.where(outward, condyle.outer, condyle.inner)
    power = np.where(outward, condyle.outer_power, condyle.inner_power)
    return np.asarray((across**power + sagittal**power) ** (1 / power))


def _interpolate_notch(y_mm: Array, notch: NotchShape) -> tuple[Array, Array, Array]:
    """Interpolate the height (mm), the curvature (1/mm) and the half width (mm) of the notch roof at positions y."""
    rows = np.array(notch.sections)
    roof, bend, half = (np.interp(y_mm, rows[:, 0], rows[:, k]) for k in (1, 2, 3))
    return roof, bend, half


def notch_distance_mm(points: Array, notch: NotchShape) -> Array:
    """Compute the approximate signed distance of points from the intercondylar notch.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points in the frame of the femur.
    notch : NotchShape
        Shape parameters of the notch.

    Returns
    -------
    (n,) float64 array
        Distance in mm, negative inside the notch.
    """
    roof, bend, half = _interpolate_notch(points[:, 1], notch)
    across = points[:, 0]
    under = (points[:, 2] - roof + bend * across**2) / np.sqrt(1.29 + (2 * bend * across) ** 2)
    return smooth_intersection(under, np.abs(across) - half - notch.flare * np.maximum(roof - points[:, 2], 0.0), 5.0)


def _compute_shell_thickness_mm(
    shape: FemurShape, points: Array, cortex_scale: float, plate_scale: float | Array
) -> Array:
    """Compute the thickness (n,) of cortex or subchondral bone plate at points (n, 3), in mm.

    `cortex_scale` and `plate_scale` are thicknesses relative to the template. `plate_scale` is a number or an array
    (n,).
    """
    share = np.clip((shape.plate_below_z - points[:, 2]) / 4.0, 0.0, 1.0)
    share *= np.clip((shape.plate_within_x - np.abs(points[:, 0])) / 4.0, 0.0, 1.0)
    shell = (1 - share) * make_thickness_profile(shape.cortex, cortex_scale)(
        points[:, 2]
    ) + share * shape.plate_mm * plate_scale
    # The notch bears no load, so its walls are thin. Over 3 mm, the walls blend into the subchondral bone plate of the
    # condyles.
    within = np.clip(1 - notch_distance_mm(points, shape.notch) / 3.0, 0.0, 1.0)
    return np.asarray(shell + within * (shape.notch.cortex_mm * cortex_scale - shell))


def _build_csg_solid(shape: FemurShape) -> Manifold:
    """Build the femur as a Boolean combination of solids, with sharp creases."""
    sections = np.array(shape.sections)
    heights = np.concatenate((np.arange(sections[:, 0].min(), 70.0, 2.5), np.linspace(70.0, _SHAFT_CUT_Z_MM, 54)))
    solid = loft_column(sections, np.zeros_like, heights, "femur shaft", count=72)
    for side in ("medial", "lateral"):
        solid += _build_csg_condyle(getattr(shape.condyles, side), side)
    return require_valid_solid(solid - _build_csg_notch(shape.notch), "femur")


def _build_csg_condyle(condyle: Condyle, side: str) -> Manifold:
    """Build one condyle as the convex hull of 1500 points on its surface."""
    turn = np.arange(1500) * np.pi * (3 - np.sqrt(5))
    height = np.linspace(-1, 1, 1500)
    ways = np.column_stack((np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height))
    return build_hull(_condyle_centre(condyle) + ways / _condyle_norm(ways, condyle)[:, None], f"femur {side} condyle")


def _build_csg_notch(notch: NotchShape) -> Manifold:
    """Build the intercondylar notch as a loft from posterior to anterior."""
    rings = []
    for y in np.linspace(45.0, -24.0, 9):
        roof, bend, half = _interpolate_notch(np.array(y), notch)
        across = np.linspace(half, -half, 25)
        arch = np.column_stack((across, np.full(25, y), roof - bend * across**2))
        foot = half + notch.flare * (roof + 30.0)
        rings.append(np.vstack(([[-foot, y, -30.0], [foot, y, -30.0]], arch)))
    return loft(np.array(rings), "femur notch")
