"""A knee bent further: the femur rolls on the tibia, and neither compartment opens or closes."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from ..core.checks import Array, InputError
from .contours import COMPARTMENT
from .pose import Pose, moved, turned_by

# By how much the femur rolls back on the tibia in flexion: medially hardly, laterally some 15 mm in 110 degrees
# (Iwaki, Pinskerova and Freeman 2000, from memory), here the mean of both.
_BACK_MM_PER_DEG = 0.07
# What of the femur can come to lie on the tibia, and what of the tibia can bear it.
_FEMUR_BELOW_MM, _TIBIA_ABOVE_MM = 50.0, -14.0
_TOLERANCE_MM, _TURNS, _FULL_STEPS = 1e-3, 60, 10
# Where a place of the condyle slips over the plateau's rim no pose has both spaces; so near to them it is enough.
_ENOUGH_MM = 0.05
# The tibia's surface is taken as flat between its highest places in cells of this size.
_CELL_MM = 0.7


def flexed(pose: Pose, femur: Array, tibia: Array, half_ml_mm: float, degrees: float) -> Pose:
    """A pose with the femur flexed further, as far above the tibia in either compartment as it was.

    How far is told along the tibia's axis, at the place of a compartment where it is least.
    femur, tibia  (n, 3)  vertices, each bone in its own frame, mm
    half_ml_mm    half the medio-lateral width of the tibial plateau
    raises        InputError where no pose does that
    """
    low, high = (share * half_ml_mm for share in COMPARTMENT)
    plateau = tibia[(tibia[:, 2] > _TIBIA_ABOVE_MM) & (np.abs(tibia[:, 0]) < high + 3.0)]
    surface = LinearNDInterpolator(*_upper(plateau))
    lower = femur[femur[:, 2] < _FEMUR_BELOW_MM]
    # By their places in the bone, so that none comes or goes as it moves.
    sides = [lower[(side * lower[:, 0] > low) & (side * lower[:, 0] < high)] for side in (+1, -1)]

    def spaces(at: Pose) -> tuple[Array, Array]:
        """Least height over the plateau of either compartment, and where it is in x."""
        frame = at.femur_on_tibia()
        heights, x = [], []
        for side in sides:
            places = moved(side, frame)
            over = places[:, 2] - surface(places[:, :2])
            least = int(np.nanargmin(over))
            heights.append(over[least])
            x.append(places[least, 0])
        return np.array(heights), np.array(x)

    wanted, _ = spaces(pose)
    bent = replace(pose, flexion_deg=pose.flexion_deg + degrees, back_mm=pose.back_mm + _BACK_MM_PER_DEG * degrees)
    nearest, least_mm = bent, np.inf
    for turn_number in range(_TURNS):
        heights, x = spaces(bent)
        error = wanted - heights
        off_mm = float(np.abs(error).max())
        if off_mm < _TOLERANCE_MM:
            return bent
        if off_mm < least_mm:
            nearest, least_mm = bent, off_mm
        # Where two places of a condyle take turns at being the lowest, half a step finds the pose between them.
        bent = turned_by(bent, x, error if turn_number < _FULL_STEPS else error / 2)
    if least_mm < _ENOUGH_MM:
        return nearest
    raise InputError(
        f"flexion_deg = {bent.flexion_deg:g} deg: the femur does not come to lie on the tibia (left over: "
        f"{np.abs(error).max():.3g} mm); allowed: less flexion"
    )


def _upper(places: Array) -> tuple[Array, Array]:
    """Of places (n, 3) of a tibia's end the highest in each cell of a grid: (m, 2) x and y, (m,) z."""
    cell = np.floor(places[:, :2] / _CELL_MM).astype(np.int64)
    order = np.lexsort((-places[:, 2], cell[:, 1], cell[:, 0]))
    first = np.ones(len(order), np.bool_)
    first[1:] = (np.diff(cell[order], axis=0) != 0).any(axis=1)
    highest = places[order[first]]
    return highest[:, :2], highest[:, 2]
