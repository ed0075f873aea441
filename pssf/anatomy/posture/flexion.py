"""Flexion: flex a knee further. The femur rolls on the tibia, and the gaps in both compartments stay unchanged."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from ...core.checks import Array, InputError
from ..meshing.rigid_pose import Pose, adjust_femur_pose, apply_transform
from ..outlines.projected_contours import COMPARTMENT_RANGE

# Posterior shift of the femur on the tibia, in mm per degree of flexion, mean of the medial and lateral compartment.
# The shift over 110 degrees is nearly 0 medially and about 15 mm laterally (Iwaki, Pinskerova and Freeman 2000, from
# memory).
_ROLLBACK_MM_PER_DEG = 0.07
# Height below which the femur can touch the tibia, in mm in the frame of the femur.
_FEMUR_BELOW_MM = 50.0
# Height above which the tibia can touch the femur, in mm in the frame of the tibia.
_TIBIA_ABOVE_MM = -14.0
# Tolerance of the gap width in each compartment, in mm.
_TOLERANCE_MM = 1e-3
# Largest number of iterations of the search for a pose with both gaps unchanged.
_TURNS = 60
# Number of iterations with full steps; later iterations use half steps.
_FULL_STEPS = 10
# Largest accepted gap error, in mm. It applies if no pose preserves both gaps because a condyle slips over the rim of
# the plateau.
_ACCEPTED_ERROR_MM = 0.05
# Cell size of the grid that approximates the plateau surface, in mm. The surface is linear between the highest points
# of the cells.
_CELL_MM = 0.7


def flex_pose(pose: Pose, femur: Array, tibia: Array, half_ml_mm: float, flexion_deg: float) -> Pose:
    """Flex the femur further without changing its gaps to the tibia in both compartments.

    Parameters
    ----------
    pose : Pose
        Pose before the additional flexion.
    femur : (n, 3) float64 array, mm
        Vertices of the femur in the frame of the femur.
    tibia : (m, 3) float64 array, mm
        Vertices of the tibia in the frame of the tibia.
    half_ml_mm : float
        Half the medio-lateral width of the tibial plateau, in mm.
    flexion_deg : float
        Additional flexion, in degrees.

    Returns
    -------
    Pose
        Pose with the additional flexion and rollback. The smallest gap of each compartment, measured along the tibial
        axis, is unchanged.

    Raises
    ------
    InputError
        If no pose preserves the gaps of both compartments.
    """
    low, high = (share * half_ml_mm for share in COMPARTMENT_RANGE)
    plateau = tibia[(tibia[:, 2] > _TIBIA_ABOVE_MM) & (np.abs(tibia[:, 0]) < high + 3.0)]
    surface = LinearNDInterpolator(*_select_highest_points(plateau))
    lower = femur[femur[:, 2] < _FEMUR_BELOW_MM]
    # Points are selected by their position in the bone, so that the selection does not depend on the pose.
    sides = [lower[(side * lower[:, 0] > low) & (side * lower[:, 0] < high)] for side in (+1, -1)]
    wanted, _ = _measure_gaps_mm(pose, sides, surface)
    bent = replace(
        pose,
        flexion_deg=pose.flexion_deg + flexion_deg,
        rollback_mm=pose.rollback_mm + _ROLLBACK_MM_PER_DEG * flexion_deg,
    )
    nearest, least_mm = bent, np.inf
    for turn_number in range(_TURNS):
        heights, x = _measure_gaps_mm(bent, sides, surface)
        error = wanted - heights
        off_mm = float(np.abs(error).max())
        if off_mm < _TOLERANCE_MM:
            return bent
        if off_mm < least_mm:
            nearest, least_mm = bent, off_mm
        # If two points of a condyle alternate as the lowest point, half steps find the pose in which both points have
        # the same height.
        bent = adjust_femur_pose(bent, x, error if turn_number < _FULL_STEPS else error / 2)
    if least_mm < _ACCEPTED_ERROR_MM:
        return nearest
    raise InputError(
        f"flexion_deg must allow contact between femur and tibia, got {bent.flexion_deg:g} deg with a residual gap of "
        f"{np.abs(error).max():.3g} mm: reduce the flexion"
    )


def _measure_gaps_mm(at: Pose, sides: list[Array], surface: LinearNDInterpolator) -> tuple[Array, Array]:
    """Measure the smallest gap above the plateau in each compartment (2,) and its position in x (2,), in mm.

    `sides` are points (n, 3) on the medial and lateral femur, in mm. `surface` gives the height of the plateau.
    """
    frame = at.femur_to_tibia_transform()
    heights, x = [], []
    for side in sides:
        places = apply_transform(side, frame)
        over = places[:, 2] - surface(places[:, :2])
        least = int(np.nanargmin(over))
        heights.append(over[least])
        x.append(places[least, 0])
    return np.array(heights), np.array(x)


def _select_highest_points(places: Array) -> tuple[Array, Array]:
    """Select the highest point per grid cell from points (n, 3); return its x and y (m, 2) and z (m,), all in mm."""
    cell = np.floor(places[:, :2] / _CELL_MM).astype(np.int64)
    order = np.lexsort((-places[:, 2], cell[:, 1], cell[:, 0]))
    first = np.ones(len(order), np.bool_)
    first[1:] = (np.diff(cell[order], axis=0) != 0).any(axis=1)
    highest = places[order[first]]
    return highest[:, :2], highest[:, 2]
