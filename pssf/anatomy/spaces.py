"""The femur above the tibia: tilt and height that give a knee its joint spaces, in the view that defines them."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..core.checks import Array, InputError
from ..geometry.cut import up_to
from ..geometry.mesh import Indices, Mesh
from ..geometry.view import View, magnification, project, view_of
from ..model.knee import Knee
from ..model.protocol import Protocol
from .bone_build import Build, formed, formed_femur_stood, formed_tibia_stood
from .contours import measure_gap
from .landmarks import plateau_floor
from .osteophytes import BoneWithOsteophytes
from .pose import Pose, moved, turned_by
from .solids import closed_edges, edges_of, mesh_of, solid_of
from .subluxation import SubluxedPose
from .wear import worn_outer

# Of the mean man's femur: about here it flexes, the middle of the condyles' round backs.
_PIVOT_MM = (0.0, 2.0, 23.0)
# Of the femur only what is below this, and of the tibia only what is above, can be the edge of the joint space.
_FEMUR_BELOW_MM, _TIBIA_ABOVE_MM = 24.0, -14.0
_TOLERANCE_MM = 1e-4
# The joint line need lie no nearer to the origin than this. Once it does the tibia stays where it is, and with it the
# landmarks on its floor, which jump a little where it moves.
_LEVEL_MM = 0.02
# Where such a jump answers each shift with another this never ends: after so many turns the tibia stays if the line is
# as near as this, and after more if it is as near as that, and the spaces alone are solved for.
_LEVELLED, _NEARLY_LEVEL_MM = 8, 0.2
_GIVEN_UP, _FAR_FROM_LEVEL_MM = 16, 1.0
_TURNS = 40
# Of narrower knees it is looked whether bones meet, so often at most; what is beyond this from the joint is left out.
_NEAR_MM, _WORN_TURNS, _SOLID_MM = 3.0, 16, 45.0
# Of a pose: medial and lateral space, mm, where in x each is least, and by how much the joint line is too high.
Measure = Callable[[Pose], tuple[Array, Array, float]]
# The same of a pose, the plateau in it and the plateau's edges.
Measured = Callable[[Pose, Mesh, Indices], tuple[Array, Array, float]]


def solve_pose(
    knee: Knee, build: Build, femur: BoneWithOsteophytes, tibia: BoneWithOsteophytes, protocol: Protocol
) -> Pose:
    """Tilt and height of the femur that give both joint spaces as they are defined (Newton on the projection).

    protocol  that the knee's joint spaces are defined under, in whose posture the pose then is
    raises    InputError if the spaces cannot be met, which the ranges of `Knee` exclude
    """
    posture = protocol.posture
    wanted = np.array([knee.jsw_medial_mm, knee.jsw_lateral_mm])
    _, y, z = (formed(np.array([_PIVOT_MM]), build.femur)[0] * build.scale).tolist()
    pose: Pose = SubluxedPose(
        tilt_deg=0.0,
        raise_mm=float(wanted.mean()) + 2.0,
        shift_mm=0.0,
        flexion_deg=knee.flexion_deg + posture.flexion_deg,
        rotation_deg=knee.rotation_deg + posture.rotation_deg,
        pivot_mm=(0.0, y, z),
        lean_deg=build.tibia_varus_deg - knee.lean_deg - posture.tilt_deg,
        forward_deg=posture.tibia_forward_deg,
        medial_mm=knee.subluxation_mm,
    )
    lower = _lower(femur, build)
    measured = partial(_measured, knee, build, protocol, lower)
    pose = _solved(knee, _measure(measured, _upper(tibia, build)), pose)
    if wanted.min() > _NEAR_MM:
        return pose
    return _settled(wanted, _measure_worn(measured, build, femur, tibia), pose)


def _solved(knee: Knee, measure: Measure, pose: Pose) -> Pose:
    wanted = np.array([knee.jsw_medial_mm, knee.jsw_lateral_mm])
    for turn in range(_TURNS):
        level_mm = _level_mm(turn)
        spaces, x, high = measure(pose)
        error = wanted - spaces
        if np.abs(error).max() < _TOLERANCE_MM and abs(high) < level_mm:
            return pose
        better = turned_by(pose, x, error)
        if abs(high) >= level_mm:
            better = replace(better, shift_mm=pose.shift_mm - high - (better.raise_mm - pose.raise_mm) / 2)
        pose = better
    raise InputError(
        f"jsw_medial_mm = {knee.jsw_medial_mm} mm with jsw_lateral_mm = {knee.jsw_lateral_mm} mm: no pose of the femur "
        f"gives both (left over: {np.abs(error).max():.3g} mm); allowed: spaces closer to each other"
    )


def _settled(wanted: Array, measure: Measure, pose: Pose) -> Pose:
    """The pose whose spaces are nearest to what is wanted once the plateau is worn, which the pose moves a little.

    A worn plateau gives way: where a space answers a step by less than half of it the next one is twice as long.
    """
    best, least, last, longer = pose, np.inf, np.zeros(2), np.ones(2)
    for _ in range(_WORN_TURNS):
        spaces, x, _ = measure(pose)
        error = wanted - spaces
        if np.abs(error).max() < least:
            best, least = pose, float(np.abs(error).max())
        if least < _TOLERANCE_MM:
            break
        longer = np.where(error * last > 0.5 * last * last, 2 * longer, 1.0)
        pose, last = turned_by(pose, x, longer * error), error
    return best


def _level_mm(turn: int) -> float:
    """How far the joint line may lie from the origin."""
    if turn < _LEVELLED:
        return _LEVEL_MM
    return _NEARLY_LEVEL_MM if turn < _GIVEN_UP else _FAR_FROM_LEVEL_MM


def _measure(measured: Measured, upper: Mesh) -> Measure:
    """Spaces over a plateau as it is; upper: of `_upper`."""
    edges = edges_of(upper.faces)

    def measure(pose: Pose) -> tuple[Array, Array, float]:
        return measured(pose, Mesh(moved(upper.vertices, pose.tibia()), upper.faces), edges)

    return measure


def _measure_worn(measured: Measured, build: Build, femur: BoneWithOsteophytes, tibia: BoneWithOsteophytes) -> Measure:
    """Spaces over a plateau that is worn where the femur stands in it."""
    above, below = (
        solid_of(*up_to(Mesh(stood(bone.formed, build), bone.mesh.faces), up, up * _SOLID_MM), "joint")
        for bone, stood, up in ((femur, formed_femur_stood, 1), (tibia, formed_tibia_stood, -1))
    )

    def measure(pose: Pose) -> tuple[Array, Array, float]:
        plateau = mesh_of(worn_outer(below.transform(pose.tibia()), above.transform(pose.femur())))
        return measured(pose, plateau, edges_of(plateau.faces))

    return measure


def _measured(
    knee: Knee,
    build: Build,
    protocol: Protocol,
    lower: tuple[Array, Indices],
    pose: Pose,
    plateau: Mesh,
    edges: Indices,
) -> tuple[Array, Array, float]:
    """Spaces as vertical gaps on the detector: to the tibia's contour, or to the floor of its plateau.

    lower    of `_lower`
    plateau  where it is, and its edges
    """
    view, mirror, lean = view_of(protocol), [1.0, protocol.posture.mirror_y, 1.0], pose.lean_deg
    femur, upper = (moved(lower[0], pose.femur()) * mirror, lower[1]), Mesh(plateau.vertices * mirror, plateau.faces)
    tibia = plateau_floor(upper, view, 1, lean) if knee.jsw_as == "read" else (upper.vertices, edges)
    gaps = [measure_gap(femur, tibia, view, side, build.half_ml_mm, lean) for side in (+1, -1)]
    x = [(gap.columns_px[gap.narrowest] - (view.cols - 1) / 2) * gap.scale_mm for gap in gaps]
    return np.array([gap.jsw_mm for gap in gaps]), np.array(x), _middle_mm(gaps, view)


def _lower(femur: BoneWithOsteophytes, build: Build) -> tuple[Array, Indices]:
    """Vertices and edges of the lower end of a femur at this knee's size."""
    edges = closed_edges(femur.mesh.faces)
    lower = edges[(femur.mesh.vertices[edges, 2] < _FEMUR_BELOW_MM).any(axis=1)]
    return femur.formed * build.scale, lower


def _upper(tibia: BoneWithOsteophytes, build: Build) -> Mesh:
    """The upper end of a tibia as it stands in this knee."""
    places, faces = formed_tibia_stood(tibia.formed, build), tibia.mesh.faces
    return Mesh(places, faces[(places[faces, 2] > 2 * _TIBIA_ABOVE_MM).any(axis=1)])


def _middle_mm(gaps: list, view: View) -> float:
    """Height of the middle of the joint line in the joint plane."""
    origin_row = project(np.zeros((1, 3)), view)[0, 0]
    rows = np.mean([gap.middle_px()[0] for gap in gaps])
    return float((origin_row - rows) * view.pixel_mm / magnification(view))
