"""The joint: places the femur over the tibia so that the projected joint spaces are what the knee asks for."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array, InputError
from ..data.bones import BoneShape
from ..geometry.mesh import Indices
from ..geometry.view import View, magnification, project
from ..model.knee import Knee
from .bone_build import Build, build_of, formed, stand_femur, stand_tibia
from .bones import grown_femur, grown_tibia
from .contours import measure_gap
from .femur import mean_femur
from .mean_bone import MeanBone
from .osteophytes import BoneWithOsteophytes
from .solids import edges_of, mesh_of
from .tibia import mean_tibia

_TOLERANCE_MM = 1e-4
# Of the mean man's femur: about here it flexes, the middle of the condyles' round backs.
_PIVOT_MM = (0.0, 2.0, 23.0)


@dataclass(frozen=True)
class Pose:
    """Where the bones go: the femur is flexed, tilted about y and raised; all is then moved, turned about z and leant.

    lean_deg  of the whole leg about y, in the plane of the film, after all else
    """

    tilt_deg: float
    raise_mm: float
    shift_mm: float
    flexion_deg: float
    rotation_deg: float
    pivot_mm: tuple[float, float, float]
    lean_deg: float = 0.0

    def femur(self) -> Array:
        """(3, 4)  transform of the femur into the knee frame"""
        return self._leg(self.femur_on_tibia())

    def femur_on_tibia(self) -> Array:
        """(3, 4)  transform of the femur into the tibia's frame"""
        flex = _turn(0, -self.flexion_deg)
        pivot = np.asarray(self.pivot_mm)
        matrix = np.column_stack((flex, pivot - flex @ pivot))
        matrix = _turn(1, self.tilt_deg) @ matrix
        matrix[2, 3] += self.raise_mm
        return matrix

    def tibia(self) -> Array:
        """(3, 4)  transform of tibia and fibula into the knee frame"""
        return self._leg(np.eye(3, 4))

    def soft(self) -> Array:
        """(3, 4)  transform of the soft tissue into the knee frame"""
        return np.column_stack((self._turned(), np.zeros(3)))

    def _leg(self, matrix: Array) -> Array:
        moved = matrix.copy()
        moved[2, 3] += self.shift_mm
        return self._turned() @ moved

    def _turned(self) -> Array:
        return _turn(1, self.lean_deg) @ _turn(2, self.rotation_deg)


def _turn(axis: int, degrees: float) -> Array:
    angle = np.deg2rad(degrees)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix


def moved(vertices_mm: Array, transform: Array) -> Array:
    """(n, 3)  vertices after a (3, 4) transform"""
    return vertices_mm @ transform[:, :3].T + transform[:, 3]


@dataclass(frozen=True)
class KneeAssembly:
    """A knee's build, its outer femur and tibia at the mean man's size, and where they go.

    reference  the view that its joint spaces are defined in
    """

    reference: View
    build: Build
    femur: BoneWithOsteophytes
    tibia: BoneWithOsteophytes
    pose: Pose

    def femur_mm(self, points: Array) -> Array:
        """(n, 3)  places of the mean man's femur in the frame of a right knee

        points  (n, 3)  mm
        """
        return moved(stand_femur(points, self.build), self.pose.femur())

    def tibia_mm(self, points: Array) -> Array:
        """(n, 3)  places of the mean man's tibia in the frame of a right knee

        points  (n, 3)  mm
        """
        return moved(stand_tibia(points, self.build), self.pose.tibia())


def assemble(knee: Knee, shape: BoneShape, reference: View) -> KneeAssembly:
    """How a knee stands.

    shape      of the mean man's bones
    reference  the view that its joint spaces are defined in
    raises     InputError if the joint spaces cannot be met
    """
    build = build_of(knee, shape)
    # The first knee after an installation waits seconds for both; they need not wait for each other.
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(MeanBone.prepare, (mean_femur(shape.femur), mean_tibia(shape.tibia))))
    femur, tibia = grown_femur(build, knee.osteophytes), grown_tibia(build, knee.osteophytes)
    pose = solve_pose(knee, build, femur.outer, tibia.outer, reference)
    # The femur's tilt closes the joint; its shaft gives that tilt back, so that varus_deg is the angle of the shafts.
    build = replace(build, femur_valgus_deg=build.femur_valgus_deg + pose.tilt_deg)
    # Spaces are measured along the leg, however it leans; so its lean comes last.
    pose = replace(pose, lean_deg=build.tibia_varus_deg - knee.lean_deg)
    return KneeAssembly(reference, build, femur, tibia, pose)


def solve_pose(knee: Knee, build: Build, femur: Manifold, tibia: Manifold, view: View) -> Pose:
    """Tilt and height of the femur that give both joint spaces in a view (Newton on the projection).

    femur, tibia  outer solids at the mean man's size, in their own frames
    raises  InputError if the spaces cannot be met, which the ranges of `Knee` exclude
    """
    meshes = [_lower(femur, build), _upper(tibia, build)]
    wanted = np.array([knee.jsw_medial_mm, knee.jsw_lateral_mm])
    _, y, z = (formed(np.array([_PIVOT_MM]), build.femur)[0] * build.scale).tolist()
    pose = Pose(0.0, wanted.mean() + 2.0, 0.0, knee.flexion_deg, knee.rotation_deg, (0.0, y, z))
    for _ in range(40):
        placed = [(moved(v, t), e) for (v, e), t in zip(meshes, (pose.femur(), pose.tibia()), strict=True)]
        gaps = [measure_gap(placed[0], placed[1], view, side, build.half_ml_mm) for side in (+1, -1)]
        error = wanted - np.array([gap.jsw_mm for gap in gaps])
        middle = _middle_mm(gaps, view)
        if np.abs(error).max() < _TOLERANCE_MM and abs(middle) < 1e-3:
            return pose
        x = [(gap.columns_px[gap.narrowest] - (view.cols - 1) / 2) * gap.scale_mm for gap in gaps]
        # A tilt about y by dB lowers a point at x by x dB (right-handed, z' = -x sin B + z cos B).
        lift, turn = np.linalg.solve([[1.0, -x[0]], [1.0, -x[1]]], error)
        pose = replace(
            pose,
            tilt_deg=pose.tilt_deg + float(np.rad2deg(turn)),
            raise_mm=pose.raise_mm + float(lift),
            shift_mm=pose.shift_mm - middle - float(lift) / 2,
        )
    raise InputError(
        f"jsw_medial_mm = {knee.jsw_medial_mm} mm with jsw_lateral_mm = {knee.jsw_lateral_mm} mm: no pose of the femur "
        f"gives both (left over: {np.abs(error).max():.3g} mm); allowed: spaces closer to each other"
    )


# Of the femur only what is below this, and of the tibia only what is above, can be the edge of the joint space.
_FEMUR_BELOW_MM, _TIBIA_ABOVE_MM = 24.0, -14.0


def _lower(femur: Manifold, build: Build) -> tuple[Array, Indices]:
    """Vertices and edges of the lower end of a femur at the mean man's size, in this knee's."""
    mesh = mesh_of(femur)
    edges = edges_of(mesh.faces)
    lower = edges[(mesh.vertices[edges, 2] < _FEMUR_BELOW_MM).any(axis=1)]
    return formed(mesh.vertices, build.femur) * build.scale, lower


def _upper(tibia: Manifold, build: Build) -> tuple[Array, Indices]:
    """Vertices and edges of the upper end of a tibia at the mean man's size, as it stands in this knee."""
    mesh = mesh_of(tibia)
    places, edges = stand_tibia(mesh.vertices, build), edges_of(mesh.faces)
    return places, edges[(places[edges, 2] > _TIBIA_ABOVE_MM).any(axis=1)]


def _middle_mm(gaps: list, view: View) -> float:
    """Height of the middle of the joint line in the joint plane."""
    origin_row = project(np.zeros((1, 3)), view)[0, 0]
    rows = np.mean([gap.middle_px()[0] for gap in gaps])
    return float((origin_row - rows) * view.pixel_mm / magnification(view))
