"""Proximal tibia of a right knee: flared shaft, plateau with two spines, and tuberosity, blended with fillets.

Coordinates are in mm at template size: x medial, y posterior, z proximal, and z = 0 at the centre of a level plateau.
"""

import atexit
from functools import lru_cache

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array
from ...data.anatomy.bone_tables import PlateauGaussian, TibiaShape
from ...data.anatomy.shape_table import ShapeModel
from ..meshing.implicit_shapes import (
    ColumnField,
    ScalarField,
    ellipsoid_distance_mm,
    smooth_intersection,
    smooth_union,
)
from ..meshing.solids import (
    SHAFT_POWER,
    build_height_field,
    loft_column,
    make_thickness_profile,
    require_valid_solid,
)
from .template_bone import TemplateBone, make_template_bone

# Height at which the shaft ends in a flat cut, in mm. The cut is outside the beam of every protocol in the package.
_SHAFT_CUT_Z_MM = -285.0


@lru_cache(maxsize=4)
def make_template_tibia(shape: TibiaShape, forms: ShapeModel) -> TemplateBone:
    """Make the template tibia with a level plateau.

    Parameters
    ----------
    shape : TibiaShape
        Shape parameters of the tibia.
    forms : ShapeModel
        Statistical shape model. Edges are made short enough for its deformations.

    Returns
    -------
    TemplateBone
        Template tibia. Equal arguments return the same object.
    """
    return make_template_bone(
        "tibia", shape, make_distance_field(shape), _compute_shell_thickness_mm, _build_csg_solid, forms
    )


# When Python exits, manifold3d writes a message to standard error if solids still exist. Clearing the cache prevents
# this message.
atexit.register(make_template_tibia.cache_clear)


def make_distance_field(shape: TibiaShape) -> ScalarField:
    """Make the distance field of the outer surface of the tibia.

    Parameters
    ----------
    shape : TibiaShape
        Shape parameters of the tibia.

    Returns
    -------
    callable
        Function that maps points (n, 3), in mm, to approximate signed distances (n,), in mm, negative inside.
    """
    shaft_field = ColumnField(np.array(shape.sections), SHAFT_POWER)

    def field(points: Array) -> Array:
        whole = smooth_intersection(shaft_field(_equalise_depth(points, shape)), _SHAFT_CUT_Z_MM - points[:, 2], 0.5)
        for part in shape.bumps:
            whole = smooth_union(whole, ellipsoid_distance_mm(points, part.centre, part.half), part.fillet_mm)
        far = np.minimum(np.abs(points[:, 1]) / shape.far_rim_y, 1.0) ** 2
        rim_mm = shape.rim_mm + far * (shape.far_rim_mm - shape.rim_mm)
        return smooth_intersection(whole, height_above_plateau_mm(points, shape.relief), rim_mm)

    return field


def height_above_plateau_mm(points: Array, relief: tuple[PlateauGaussian, ...]) -> Array:
    """Compute the approximate distance of points above the surface of the plateau.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points in the frame of the tibia.
    relief : tuple of PlateauGaussian
        Gaussian functions whose sum is the surface relief of the plateau.

    Returns
    -------
    (n,) float64 array
        Distance in mm, negative below the surface.
    """
    height, slope_x, slope_y = _evaluate_relief(points[:, 0], points[:, 1], relief)
    return (points[:, 2] - height) / np.sqrt(1 + slope_x**2 + slope_y**2)


def plateau_height_mm(x: Array, y: Array, relief: tuple[PlateauGaussian, ...]) -> Array:
    """Compute the height of a level plateau.

    Parameters
    ----------
    x : (n,) float64 array, mm
        Medio-lateral coordinates in the frame of the tibia.
    y : (n,) float64 array, mm
        Antero-posterior coordinates in the frame of the tibia.
    relief : tuple of PlateauGaussian
        Gaussian functions whose sum is the surface relief of the plateau.

    Returns
    -------
    (n,) float64 array
        Height in mm.
    """
    return _evaluate_relief(x, y, relief)[0]


def _equalise_depth(points: Array, shape: TibiaShape) -> Array:
    """Scale points (n, 3), in mm, in the antero-posterior direction.

    The scaled medial and lateral plateaus have the same antero-posterior depth as the plateau centre.
    """
    fade = np.clip(1 - points[:, 2] / shape.deeper_above_z, 0.0, 1.0) ** 2
    places = points.copy()
    places[:, 1] /= 1 + np.clip(shape.deeper_medially * points[:, 0], -0.15, 0.15) * fade
    return places


def _evaluate_relief(x: Array, y: Array, relief: tuple[PlateauGaussian, ...]) -> tuple[Array, Array, Array]:
    """Evaluate the height (mm) of the plateau and its slopes along x and y, as a sum of Gaussian functions.

    Negative Gaussian functions form the concave articular surfaces.
    """
    height, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    for bell in relief:
        u, v = (x - bell.x) / bell.half_x, (y - bell.y) / bell.half_y
        part = bell.height * np.exp(-(u**2) - v**2)
        height += part
        slope_x -= 2 * u / bell.half_x * part
        slope_y -= 2 * v / bell.half_y * part
    return height, slope_x, slope_y


def _compute_shell_thickness_mm(
    shape: TibiaShape, points: Array, cortex_scale: float, plate_scale: float | Array
) -> Array:
    """Compute the thickness (n,) of cortex or subchondral bone plate at points (n, 3), in mm.

    `cortex_scale` and `plate_scale` are thicknesses relative to the template. `plate_scale` is a number or an array
    (n,).
    """
    # The subchondral bone plate blends into the cortex of the metaphysis over the first 3 mm below the surface.
    share = np.clip(1 + height_above_plateau_mm(points, shape.relief) / 3.0, 0.0, 1.0)
    plates = shape.plate_mm + plateau_height_mm(points[:, 0], points[:, 1], shape.plates)
    return np.asarray(
        (1 - share) * make_thickness_profile(shape.cortex, cortex_scale)(points[:, 2]) + share * plates * plate_scale
    )


def _build_csg_solid(shape: TibiaShape) -> Manifold:
    """Build the tibia as a Boolean combination of solids, with sharp creases."""
    sections = np.array(shape.sections)
    heights = np.concatenate((np.linspace(_SHAFT_CUT_Z_MM, -60.0, 56), np.arange(-57.5, sections[:, 0].max(), 2.5)))
    shaft = loft_column(sections, np.zeros_like, heights, "tibia shaft", count=72)
    for part in shape.bumps:
        shaft += Manifold.sphere(1.0, 48).scale(part.half).translate(part.centre)
    x, y = np.linspace(-45, 45, 61), np.linspace(-36, 32, 46)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    top = plateau_height_mm(gx.ravel(), gy.ravel(), shape.relief).reshape(gx.shape)
    return require_valid_solid(shaft ^ build_height_field(x, y, top, _SHAFT_CUT_Z_MM - 10.0, "tibial plateau"), "tibia")
