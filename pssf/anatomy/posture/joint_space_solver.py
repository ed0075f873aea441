"""Joint space solver: find the tilt and height of the femur that give the specified joint space width (JSW)."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ...core.checks import Array, InputError
from ...geometry.mesh import Indices, Mesh
from ...geometry.mesh_cut import cut_mesh_at_height
from ...geometry.view import (
    View,
    magnification,
    project_points,
    resolve_view,
)
from ...model.knee import Knee
from ...model.protocol import Protocol
from ..bones.osteophyte_growth import BoneWithOsteophytes
from ..bones.plateau_wear import wear_outer_tibia
from ..meshing.rigid_pose import Pose, adjust_femur_pose, apply_transform
from ..meshing.solids import (
    build_solid,
    extract_mesh,
    find_closed_mesh_edges,
    find_edges,
)
from ..outlines.contour_landmarks import find_plateau_floor
from ..outlines.projected_contours import measure_gap
from ..template.bone_builder import (
    BoneParameters,
    deform_template_points,
    scale_and_lean_femur,
    scale_slope_and_lean_tibia,
)
from .subluxation import SubluxedPose

# Point on the flexion axis of the template femur: the centre of the round posterior condyles, in mm.
_PIVOT_MM = (0.0, 2.0, 23.0)
# Height below which the femur can bound the joint space, in mm.
_FEMUR_BELOW_MM = 24.0
# Height above which the tibia can bound the joint space, in mm.
_TIBIA_ABOVE_MM = -14.0
# Tolerance of the JSW, mm.
_TOLERANCE_MM = 1e-4
# Initial tolerance for the joint-line height above the origin, in mm. Within this tolerance, the tibia is not moved
# further, because each move shifts landmarks on the plateau floor abruptly.
_LEVEL_MM = 0.02
# First iteration with the second tolerance for the joint-line height. A larger tolerance helps if landmark
# shifts prevent convergence.
_LEVELLED = 8
# Second tolerance for the joint-line height above the origin, in mm.
_NEARLY_LEVEL_MM = 0.2
# First iteration with the third tolerance for the joint-line height.
_GIVEN_UP = 16
# Third tolerance for the joint-line height above the origin, in mm.
_FAR_FROM_LEVEL_MM = 1.0
# Largest number of Newton iterations without wear.
_MAX_ITERATIONS = 40
# JSW above which the bones cannot overlap and wear is not computed, in mm.
_NEAR_MM = 3.0
# Largest number of iterations that refine the pose with wear.
_WORN_TURNS = 16
# Distance from the joint at which the bones are cut off before wear is computed, mm.
_SOLID_MM = 45.0
# A pose measure maps a pose to medial and lateral JSW (2,), in mm, their positions in x (2,), in mm, and the height of
# the joint line, in mm.
PoseMeasure = Callable[[Pose], tuple[Array, Array, float]]
# A plateau measure maps a pose, the plateau in this pose and the mesh edges of the plateau to the results of a
# `PoseMeasure`.
PlateauMeasure = Callable[[Pose, Mesh, Indices], tuple[Array, Array, float]]


def solve_pose(
    knee: Knee,
    bone_parameters: BoneParameters,
    femur: BoneWithOsteophytes,
    tibia: BoneWithOsteophytes,
    protocol: Protocol,
) -> Pose:
    """Find the tilt and height of the femur that give the specified JSW in both compartments, by Newton's method.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    femur : BoneWithOsteophytes
        Outer surface of the femur with osteophytes.
    tibia : BoneWithOsteophytes
        Outer surface of the tibia with osteophytes.
    protocol : Protocol
        Protocol under which the specified JSW of the knee applies. The resulting pose has the posture of this protocol.

    Returns
    -------
    Pose
        Pose of the leg under `protocol`.

    Raises
    ------
    InputError
        If no pose gives both the medial and the lateral JSW. Values within the ranges of `Knee` do not cause this
        error.
    """
    posture = protocol.posture
    wanted = np.array([knee.jsw_medial_mm, knee.jsw_lateral_mm])
    _, y, z = (deform_template_points(np.array([_PIVOT_MM]), bone_parameters.femur)[0] * bone_parameters.scale).tolist()
    pose: Pose = SubluxedPose(
        tilt_deg=0.0,
        raise_mm=float(wanted.mean()) + 2.0,
        shift_mm=0.0,
        flexion_deg=knee.flexion_deg + posture.flexion_deg,
        rotation_deg=knee.rotation_deg + posture.rotation_deg,
        pivot_mm=(0.0, y, z),
        lean_deg=bone_parameters.tibia_varus_deg - knee.lean_deg - posture.tilt_deg,
        forward_deg=posture.tibia_forward_deg,
        medial_shift_mm=knee.subluxation_mm,
    )
    lower = _select_lower_femur(femur, bone_parameters)
    measured = partial(_measure_spaces, knee, bone_parameters, protocol, lower)
    pose = _solve_for_spaces(knee, _make_pose_measure(measured, _select_upper_tibia(tibia, bone_parameters)), pose)
    if wanted.min() > _NEAR_MM:
        return pose
    return _refine_for_wear(wanted, _make_worn_pose_measure(measured, bone_parameters, femur, tibia), pose)


def _solve_for_spaces(knee: Knee, measure: PoseMeasure, pose: Pose) -> Pose:
    """Find the pose with the specified JSW in both compartments, by Newton's method.

    In this pose, the joint line is at the height of the origin.
    """
    wanted = np.array([knee.jsw_medial_mm, knee.jsw_lateral_mm])
    for turn in range(_MAX_ITERATIONS):
        level_mm = _select_level_tolerance_mm(turn)
        spaces, x, high = measure(pose)
        error = wanted - spaces
        if np.abs(error).max() < _TOLERANCE_MM and abs(high) < level_mm:
            return pose
        better = adjust_femur_pose(pose, x, error)
        if abs(high) >= level_mm:
            better = replace(better, shift_mm=pose.shift_mm - high - (better.raise_mm - pose.raise_mm) / 2)
        pose = better
    raise InputError(
        f"jsw_medial_mm and jsw_lateral_mm must be possible in the same pose, got {knee.jsw_medial_mm} mm and "
        f"{knee.jsw_lateral_mm} mm with a residual of {np.abs(error).max():.3g} mm: choose values closer to each other"
    )


def _refine_for_wear(target_jsw_mm: Array, measure: PoseMeasure, pose: Pose) -> Pose:
    """Refine the pose until the JSW (2,) over the worn plateau is closest to its target, in mm.

    A lower femur wears the plateau deeper, so the JSW changes by less than the step. If a step removes less than half
    of the error, the next step is doubled.
    """
    best, least, last, longer = pose, np.inf, np.zeros(2), np.ones(2)
    for _ in range(_WORN_TURNS):
        spaces, x, _ = measure(pose)
        error = target_jsw_mm - spaces
        if np.abs(error).max() < least:
            best, least = pose, float(np.abs(error).max())
        if least < _TOLERANCE_MM:
            break
        longer = np.where(error * last > 0.5 * last * last, 2 * longer, 1.0)
        pose, last = adjust_femur_pose(pose, x, longer * error), error
    return best


def _select_level_tolerance_mm(iteration: int) -> float:
    """Return the tolerance for the joint-line height at an iteration, mm."""
    if iteration < _LEVELLED:
        return _LEVEL_MM
    return _NEARLY_LEVEL_MM if iteration < _GIVEN_UP else _FAR_FROM_LEVEL_MM


def _make_pose_measure(measure_plateau: PlateauMeasure, upper_tibia: Mesh) -> PoseMeasure:
    """Make a function that measures the JSW above an unworn plateau.

    `upper_tibia` is the mesh that `_select_upper_tibia` returns.
    """
    edges = find_edges(upper_tibia.faces)

    def measure(pose: Pose) -> tuple[Array, Array, float]:
        return measure_plateau(
            pose, Mesh(apply_transform(upper_tibia.vertices, pose.tibia_transform()), upper_tibia.faces), edges
        )

    return measure


def _make_worn_pose_measure(
    measure_plateau: PlateauMeasure,
    bone_parameters: BoneParameters,
    femur: BoneWithOsteophytes,
    tibia: BoneWithOsteophytes,
) -> PoseMeasure:
    """Make a function that measures the JSW above a plateau that is worn where the femur overlaps it."""
    above, below = (
        build_solid(
            *cut_mesh_at_height(
                Mesh(stood(bone.deformed_vertices_mm, bone_parameters), bone.mesh.faces), up, up * _SOLID_MM
            ),
            "joint end of a bone",
        )
        for bone, stood, up in ((femur, scale_and_lean_femur, 1), (tibia, scale_slope_and_lean_tibia, -1))
    )

    def measure(pose: Pose) -> tuple[Array, Array, float]:
        plateau = extract_mesh(
            wear_outer_tibia(below.transform(pose.tibia_transform()), above.transform(pose.femur_transform()))
        )
        return measure_plateau(pose, plateau, find_edges(plateau.faces))

    return measure


def _measure_spaces(
    knee: Knee,
    bone_parameters: BoneParameters,
    protocol: Protocol,
    lower_femur: tuple[Array, Indices],
    pose: Pose,
    plateau: Mesh,
    edges: Indices,
) -> tuple[Array, Array, float]:
    """Measure the JSW on the detector as the vertical gap between the femur and the tibial contour or plateau floor.

    `lower_femur` is the result of `_select_lower_femur`. `plateau` is the posed upper tibia; `edges` (m, 2) are its
    mesh edges.
    """
    view, mirror, lean = resolve_view(protocol), [1.0, protocol.posture.mirror_y, 1.0], pose.lean_deg
    femur, upper = (
        (apply_transform(lower_femur[0], pose.femur_transform()) * mirror, lower_femur[1]),
        Mesh(plateau.vertices * mirror, plateau.faces),
    )
    tibia = find_plateau_floor(upper, view, 1, lean) if knee.jsw_definition == "read" else (upper.vertices, edges)
    gaps = [measure_gap(femur, tibia, view, side, bone_parameters.half_ml_mm, lean) for side in (+1, -1)]
    x = [(gap.columns_px[gap.narrowest_index] - (view.cols - 1) / 2) * gap.mm_per_pixel for gap in gaps]
    return np.array([gap.jsw_mm for gap in gaps]), np.array(x), _compute_joint_line_height_mm(gaps, view)


def _select_lower_femur(femur: BoneWithOsteophytes, bone_parameters: BoneParameters) -> tuple[Array, Indices]:
    """Return the vertices (n, 3), in mm at the size of the knee, and the edges (m, 2) of the lower end of the femur."""
    edges = find_closed_mesh_edges(femur.mesh.faces)
    lower = edges[(femur.mesh.vertices[edges, 2] < _FEMUR_BELOW_MM).any(axis=1)]
    return femur.deformed_vertices_mm * bone_parameters.scale, lower


def _select_upper_tibia(tibia: BoneWithOsteophytes, bone_parameters: BoneParameters) -> Mesh:
    """Return the mesh of the upper end of the tibia at the size of the knee, with slope and lean."""
    places, faces = scale_slope_and_lean_tibia(tibia.deformed_vertices_mm, bone_parameters), tibia.mesh.faces
    return Mesh(places, faces[(places[faces, 2] > 2 * _TIBIA_ABOVE_MM).any(axis=1)])


def _compute_joint_line_height_mm(gaps: list, view: View) -> float:
    """Compute the height of the joint line centre above the origin in the joint plane, in mm."""
    origin_row = project_points(np.zeros((1, 3)), view)[0, 0]
    rows = np.mean([gap.middle_px()[0] for gap in gaps])
    return float((origin_row - rows) * view.pixel_mm / magnification(view))
