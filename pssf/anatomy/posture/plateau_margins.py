"""Plateau margins: anterior and posterior margin of a tibial compartment, and beam alignment with the plateau.

A margin is defined in a sagittal section of the compartment. The margin is the point at which a line at 30 degrees to
the horizontal of the tibia touches the bone from above, anteriorly or posteriorly. The section is halfway between spine
and edge, where readers judge the alignment of a radiograph.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from ...core.checks import Array, InputError
from ...data.table_records import Pair
from ...geometry.mesh import Indices, Mesh
from ...geometry.view import (
    View,
    magnification,
    project_points,
    resolve_view,
)
from ...model.protocol import Protocol
from ..meshing.rigid_pose import apply_transform
from ..meshing.solids import find_crossing_sides
from ..outlines.projected_contours import COMPARTMENT_RANGE
from .knee_assembly import KneeAssembly

# Angle between the horizontal of the tibia and the tangent at a margin, degrees. The edge landmarks use the same angle.
_TANGENT_DEG = 30.0
# Height in the frame of the tibia above which points belong to the plateau, in mm.
_MIN_PLATEAU_Z_MM = -30.0
# Tolerance of the beam angle, degrees.
_TOLERANCE_DEG = 1e-6
# Sign of the x coordinate of each compartment, in the frame of the tibia.
SIDE_SIGNS = {"medial": 1.0, "lateral": -1.0}


def find_plateau_margins(assembly: KneeAssembly, tibia: Mesh, side: str) -> Array:
    """Find the anterior and the posterior margin of one compartment of the plateau.

    Parameters
    ----------
    assembly : KneeAssembly
        Bones and their pose.
    tibia : Mesh
        Outer surface of the posed tibia in the knee frame, before view rotation and mirroring, in mm.
    side : str
        "medial" or "lateral".

    Returns
    -------
    (2, 3) float64 array
        Anterior and posterior margin in the frame of `tibia`, in mm.
    """
    frame = assembly.pose.tibia_transform()
    own = (tibia.vertices - frame[:, 3]) @ frame[:, :3]
    x = float(SIDE_SIGNS[side] * sum(COMPARTMENT_RANGE) / 2 * assembly.bone_parameters.half_ml_mm)
    section = _cut_section(own, tibia.faces, x)
    turn = np.deg2rad(_TANGENT_DEG)
    touched = [(section @ (out * np.sin(turn), np.cos(turn))).argmax() for out in (-1.0, 1.0)]
    return apply_transform(np.column_stack((np.full(2, x), section[touched])), frame)


def _cut_section(points: Array, faces: Indices, x: float) -> Array:
    """Intersect the mesh edges with the plane at `x`.

    Return y and z (n, 2) of the intersection points above the shaft, in mm.
    """
    starts, ends, share = find_crossing_sides(points[:, 0], faces, x)
    places = points[starts, 1:] + share[:, None] * (points[ends, 1:] - points[starts, 1:])
    return np.asarray(places[points[starts, 2] > _MIN_PLATEAU_Z_MM])


def measure_inter_margin_mm(assembly: KneeAssembly, tibia: Mesh, view: View) -> float:
    """Measure the height of the anterior margin of the medial plateau above its posterior margin on the radiograph.

    Parameters
    ----------
    assembly : KneeAssembly
        Bones and their pose.
    tibia : Mesh
        Outer surface of the posed tibia in the knee frame, before view rotation and mirroring, in mm.
    view : View
        Projection view.

    Returns
    -------
    float
        Height difference between the anterior and the posterior margin, scaled to the joint plane, in mm. It is
        positive if the anterior margin is higher.

    Raises
    ------
    InputError
        If the view is not frontal (AP or PA), so the plateau is not projected edge-on.
    """
    if not assembly.posture.is_frontal:
        raise InputError(
            f"projection must be AP or PA to project the plateau edge-on, got {assembly.posture.projection!r}"
        )
    (front, back), _ = project_points(assembly.orient_points(find_plateau_margins(assembly, tibia, "medial")), view).T
    return float((back - front) * view.pixel_mm / magnification(view))


def align_beam_with_plateau(assembly: KneeAssembly, tibia: Mesh, protocol: Protocol, range_deg: Pair) -> Protocol:
    """Align the beam of a protocol with the medial plateau of this knee.

    Parameters
    ----------
    assembly : KneeAssembly
        Bones and their pose.
    tibia : Mesh
        Outer surface of the posed tibia in the knee frame, before view rotation and mirroring, in mm.
    protocol : Protocol
        Protocol whose `beam_angle_deg` is relative to the plateau.
    range_deg : (float, float)
        Smallest and largest allowed beam angle, in degrees.

    Returns
    -------
    Protocol
        The same protocol with ``beam_along="horizontal"`` and the resulting `beam_angle_deg`.

    Raises
    ------
    InputError
        If no beam angle within the range is parallel to the plateau.
    """
    level = replace(protocol, beam_along="horizontal")

    def apart_mm(angle_deg: float) -> float:
        return measure_inter_margin_mm(assembly, tibia, resolve_view(replace(level, beam_angle_deg=float(angle_deg))))

    low, high = (apart_mm(angle) for angle in range_deg)
    if low * high > 0:
        raise InputError(
            f"beam_along must be 'horizontal' in this posture, got {protocol.beam_along!r}: at beam angles of "
            f"{range_deg[0]:g} and {range_deg[1]:g} deg, the plateau margins are {low:.1f} and {high:.1f} mm apart"
        )
    fitted = brentq(apart_mm, *range_deg, xtol=_TOLERANCE_DEG) + protocol.beam_angle_deg
    return replace(level, beam_angle_deg=round(float(fitted), 4))
