"""The margins of the tibial plateau: what says whether a beam runs along it, and by how much the plateau slopes.

The margins of a compartment are where a line at 30 degrees to the tibia's own horizontal touches its section from
above, in front and behind, half way between the spines and the edge, where readers judge the alignment of a film.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from ..core.checks import Array, InputError
from ..data.records import Pair
from ..geometry.mesh import Indices, Mesh
from ..geometry.view import View, magnification, project, view_of
from ..model.protocol import Protocol
from .contours import COMPARTMENT
from .joint import KneeAssembly
from .pose import moved
from .solids import crossing_sides

# As of the edges among the landmarks.
_TOUCH_DEG = 30.0
# Of the tibia only what is above this, in its own frame, is plateau.
_ABOVE_MM = -30.0
_TOLERANCE_DEG = 1e-6
SIDES = {"medial": 1.0, "lateral": -1.0}


def plateau_margins(assembly: KneeAssembly, tibia: Mesh, side: str) -> Array:
    """(2, 3)  front and back margin of a compartment, mm, in the leg as it stands

    tibia  its outer surface, likewise
    side   "medial" or "lateral"
    """
    frame = assembly.pose.tibia()
    own = (tibia.vertices - frame[:, 3]) @ frame[:, :3]
    x = float(SIDES[side] * sum(COMPARTMENT) / 2 * assembly.build.half_ml_mm)
    section = _section(own, tibia.faces, x)
    turn = np.deg2rad(_TOUCH_DEG)
    touched = [(section @ (out * np.sin(turn), np.cos(turn))).argmax() for out in (-1.0, 1.0)]
    return moved(np.column_stack((np.full(2, x), section[touched])), frame)


def _section(points: Array, faces: Indices, x: float) -> Array:
    """(n, 2)  y and z of the places at which a plane cuts the sides of triangles, above the shaft"""
    starts, ends, share = crossing_sides(points[:, 0], faces, x)
    places = points[starts, 1:] + share[:, None] * (points[ends, 1:] - points[starts, 1:])
    return np.asarray(places[points[starts, 2] > _ABOVE_MM])


def inter_margin_mm(assembly: KneeAssembly, tibia: Mesh, view: View) -> float:
    """Height on the film of the front margin of the medial plateau over its back one, scaled to the joint plane.

    raises  InputError for a view in which the plateau is not seen from the front
    """
    if not assembly.posture.is_frontal:
        raise InputError(f"projection = {assembly.posture.projection!r}; allowed: AP or PA, where margins are edge on")
    (front, back), _ = project(assembly.seen(plateau_margins(assembly, tibia, "medial")), view).T
    return float((back - front) * view.pixel_mm / magnification(view))


def along_plateau(assembly: KneeAssembly, tibia: Mesh, protocol: Protocol, range_deg: Pair) -> Protocol:
    """The protocol with its beam along this knee's medial plateau, and from there by what its `beam_angle_deg` says.

    range_deg  that a beam may be tilted by
    raises  InputError where the plateau faces another way than any beam goes
    """
    level = replace(protocol, beam_along="horizontal")

    def apart_mm(angle_deg: float) -> float:
        return inter_margin_mm(assembly, tibia, view_of(replace(level, beam_angle_deg=float(angle_deg))))

    low, high = (apart_mm(angle) for angle in range_deg)
    if low * high > 0:
        raise InputError(
            f"beam_along = {protocol.beam_along!r}: at {range_deg[0]:g} and {range_deg[1]:g} deg of beam the plateau's "
            f"margins are {low:.1f} and {high:.1f} mm apart; allowed: a posture whose plateau a beam between can meet"
        )
    fitted = brentq(apart_mm, *range_deg, xtol=_TOLERANCE_DEG) + protocol.beam_angle_deg
    return replace(level, beam_angle_deg=round(float(fitted), 4))
