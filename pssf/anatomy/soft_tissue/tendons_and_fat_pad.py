"""Patellar tendon, quadriceps tendon and infrapatellar fat pad as solids."""

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array
from ...data.anatomy.soft_tissue_tables import FatPad, PatellarTendon, QuadricepsTendon
from ..meshing.rigid_pose import apply_transform
from ..meshing.solids import require_valid_solid


def build_fat_pad(part: FatPad, scale: float, tibia_frame: Array, sheath_mm: float = 0.0) -> Manifold:
    """Build the infrapatellar fat pad, before bones are subtracted from it.

    Parameters
    ----------
    part : FatPad
        Centre and semi-axes of the template fat pad in the frame of the tibia, in mm.
    scale : float
        Size of the bones relative to the template.
    tibia_frame : (3, 4) float64 array, mm
        Transform of the tibia into the knee frame, in mm.
    sheath_mm : float, default 0.0
        Margin by which the fat pad is enlarged on all sides, in mm.

    Returns
    -------
    Manifold
        Ellipsoid in the knee frame, in mm.
    """
    half, centre = np.array(part.half) * scale + sheath_mm, np.array(part.centre) * scale
    return Manifold.sphere(1.0, 36).scale(half).translate(centre).transform(tibia_frame)


def build_patellar_tendon(
    part: PatellarTendon, scale: float, apex_mm: Array, tibia_frame: Array, sheath_mm: float = 0.0
) -> Manifold:
    """Build the patellar tendon from the apex of the patella to the tibial tuberosity.

    Bones are subtracted from the tendon later.

    Parameters
    ----------
    part : PatellarTendon
        Ends and semi-axes of the template tendon, in mm.
    scale : float
        Size of the bones relative to the template.
    apex_mm : (3,) float64 array
        Apex of the patella in the knee frame, in mm.
    tibia_frame : (3, 4) float64 array, mm
        Transform of the tibia into the knee frame, in mm.
    sheath_mm : float, default 0.0
        Margin by which the tendon is enlarged on all sides, in mm.

    Returns
    -------
    Manifold
        Tendon in the knee frame, in mm.

    Raises
    ------
    InputError
        If the tendon is not a valid solid.
    """
    ends = [
        apex_mm + np.array(part.from_apex) * scale,
        apply_transform(np.array([part.tuberosity]) * scale, tibia_frame)[0],
    ]
    return _build_strap([(end, part.half) for end in ends], scale, sheath_mm, "patellar tendon")


def build_quadriceps_tendon(
    part: QuadricepsTendon, scale: float, base_mm: Array, femur_frame: Array, sheath_mm: float = 0.0
) -> Manifold:
    """Build the quadriceps tendon from the patellar base upwards along the femur.

    Bones are subtracted from the tendon later.

    Parameters
    ----------
    part : QuadricepsTendon
        Ends and semi-axes of the template tendon, in mm.
    scale : float
        Size of the bones relative to the template.
    base_mm : (3,) float64 array
        Highest point of the patella in the knee frame, in mm.
    femur_frame : (3, 4) float64 array, mm
        Transform of the femur into the knee frame, in mm.
    sheath_mm : float, default 0.0
        Margin by which the tendon is enlarged on all sides, in mm.

    Returns
    -------
    Manifold
        Tendon in the knee frame, in mm.

    Raises
    ------
    InputError
        If the tendon is not a valid solid.
    """
    turn = femur_frame[:, :3]
    low = base_mm + turn @ (np.array(part.from_base) * scale)
    high = low + turn @ (np.array(part.upwards) * scale)
    return _build_strap([(low, part.half_below), (high, part.half_above)], scale, sheath_mm, "quadriceps tendon")


def _build_strap(
    ends: list[tuple[Array, tuple[float, float, float]]], scale: float, sheath_mm: float, name: str
) -> Manifold:
    """Build the convex hull of two ellipsoids, each a pair of centre (3,) and semi-axes (3,), in mm."""
    ball = Manifold.sphere(1.0, 24)
    solids = [ball.scale(np.array(half) * scale + sheath_mm).translate(place) for place, half in ends]
    return require_valid_solid(Manifold.batch_hull(solids), name)
