"""Knee assembly: pose of the bones of a knee in a posture, with the specified joint space width (JSW)."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ...core.checks import Array
from ...geometry.mesh import Mesh
from ...model.knee import Knee
from ...model.protocol import Posture, Protocol, load_protocol
from ..bones.bone_shells import grow_femur_osteophytes, grow_tibia_osteophytes, prepare_template_bones
from ..bones.osteophyte_growth import BoneWithOsteophytes
from ..meshing.rigid_pose import Pose, apply_transform, rotation_matrix
from ..template.bone_builder import (
    BoneParameters,
    map_template_femur,
    map_template_tibia,
    scale_and_lean_femur,
    scale_slope_and_lean_tibia,
)
from .flexion import flex_pose
from .joint_space_solver import solve_pose


@dataclass(frozen=True, eq=False, kw_only=True)
class GrownBones:
    """Femur and tibia with osteophytes, and the poses that do not depend on the posture of the radiograph.

    Attributes
    ----------
    jsw_protocol : Protocol
        Protocol that defines the JSW.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee. The valgus angle of the femoral shaft compensates for the femoral tilt.
    femur : BoneWithOsteophytes
        Outer surface of the femur with osteophytes, at template size.
    tibia : BoneWithOsteophytes
        Outer surface of the tibia with osteophytes, at template size.
    jsw_pose : Pose
        Pose of the leg under `jsw_protocol`.
    straight_pose : Pose
        Pose of the straight leg.
    """

    jsw_protocol: Protocol
    bone_parameters: BoneParameters
    femur: BoneWithOsteophytes
    tibia: BoneWithOsteophytes
    jsw_pose: Pose
    straight_pose: Pose


@dataclass(frozen=True, kw_only=True)
class KneeAssembly:
    """Bones of a knee in a posture: outer surfaces of femur and tibia at template size, and their pose.

    Attributes
    ----------
    jsw_protocol : Protocol
        Protocol that defines the JSW.
    jsw_pose : Pose
        Pose of the leg under `jsw_protocol`.
    posture : Posture
        Posture of the leg.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    femur : BoneWithOsteophytes
        Outer surface of the femur with osteophytes, at template size.
    tibia : BoneWithOsteophytes
        Outer surface of the tibia with osteophytes, at template size.
    pose : Pose
        Pose of the leg in `posture`.
    mirror : (float, float, float)
        Factors of +1 or -1 along x, y and z. A left knee is mirrored along x. A view from the opposite direction is
        mirrored along y.
    view_rotation : (3, 3) float64 array or None
        Rotation of the leg into the view, before mirroring. None in a frontal view.
    """

    jsw_protocol: Protocol
    jsw_pose: Pose
    posture: Posture
    bone_parameters: BoneParameters
    femur: BoneWithOsteophytes
    tibia: BoneWithOsteophytes
    pose: Pose
    mirror: tuple[float, float, float]
    view_rotation: Array | None = None

    def place_femur_points(self, points: Array) -> Array:
        """Map points of the template femur into the posed leg.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points in the frame of the template femur.

        Returns
        -------
        (n, 3) float64 array
            Points of the right leg in the knee frame, before view rotation and mirroring, in mm.
        """
        return apply_transform(map_template_femur(points, self.bone_parameters), self.pose.femur_transform())

    def place_tibia_points(self, points: Array) -> Array:
        """Map points of the template tibia into the posed leg.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points in the frame of the template tibia.

        Returns
        -------
        (n, 3) float64 array
            Points of the right leg in the knee frame, before view rotation and mirroring, in mm.
        """
        return apply_transform(map_template_tibia(points, self.bone_parameters), self.pose.tibia_transform())

    def outer_femur_vertices_mm(self) -> Array:
        """Compute the vertices of the outer femur in the posed leg.

        Returns
        -------
        (n, 3) float64 array
            Vertices of the right leg in the knee frame, before view rotation and mirroring, in mm.
        """
        return apply_transform(
            scale_and_lean_femur(self.femur.deformed_vertices_mm, self.bone_parameters), self.pose.femur_transform()
        )

    def outer_tibia_vertices_mm(self) -> Array:
        """Compute the vertices of the outer tibia in the posed leg, without wear.

        Returns
        -------
        (n, 3) float64 array
            Vertices of the right leg in the knee frame, before view rotation and mirroring, in mm.
        """
        return apply_transform(
            scale_slope_and_lean_tibia(self.tibia.deformed_vertices_mm, self.bone_parameters),
            self.pose.tibia_transform(),
        )

    def rotate_points(self, points: Array) -> Array:
        """Rotate points of the posed leg into the view of the posture, without mirroring.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points of the posed right leg in the knee frame.

        Returns
        -------
        (n, 3) float64 array
            Rotated points, in mm.
        """
        return points if self.view_rotation is None else points @ self.view_rotation.T

    def orient_points(self, points: Array) -> Array:
        """Rotate and mirror points of the posed right leg into the frame of the scene.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points of the posed right leg in the knee frame.

        Returns
        -------
        (n, 3) float64 array
            Rotated and mirrored points, in mm.
        """
        return self.rotate_points(points) * self.mirror

    def orient_mesh(self, mesh: Mesh) -> Mesh:
        """Rotate and mirror a mesh of the posed right leg, with faces pointing outwards.

        Parameters
        ----------
        mesh : Mesh
            Mesh of the posed right leg in the knee frame, in mm.

        Returns
        -------
        Mesh
            Rotated and mirrored mesh.
        """
        faces = mesh.faces if np.prod(self.mirror) > 0 else np.ascontiguousarray(mesh.faces[:, ::-1])
        return Mesh(self.orient_points(mesh.vertices), faces)


# Name of the protocol that defines JSW for each value of `Knee.jsw_definition`.
_JSW_PROTOCOLS = {"projected": "reference", "read": "fixed_flexion"}


def load_jsw_protocol(knee: Knee) -> Protocol:
    """Load the protocol that defines JSW for the value of `knee.jsw_definition`.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.

    Returns
    -------
    Protocol
        Protocol "reference" for JSW measured between projected contours, or "fixed_flexion" for JSW as readers measure
        it.
    """
    return load_protocol(_JSW_PROTOCOLS[knee.jsw_definition])


def assemble_knee(knee: Knee, bone_parameters: BoneParameters, posture: Posture, protocol: Protocol) -> KneeAssembly:
    """Assemble the bones of a knee in a posture.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee, from `resolve_bone_parameters`.
    posture : Posture
        Posture of the leg.
    protocol : Protocol
        Protocol that defines the JSW, from `load_jsw_protocol`.

    Returns
    -------
    KneeAssembly
        Bones and their pose.

    Raises
    ------
    InputError
        If no pose gives the JSW, if the femur cannot rest on the tibia in this flexion, or if one osteophyte hides
        another osteophyte.
    """
    return pose_knee(knee, grow_bones(knee, bone_parameters, protocol), posture)


def grow_bones(knee: Knee, bone_parameters: BoneParameters, protocol: Protocol) -> GrownBones:
    """Add the osteophytes to femur and tibia, and solve the pose that gives the specified JSW.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee, from `resolve_bone_parameters`.
    protocol : Protocol
        Protocol that defines the JSW, from `load_jsw_protocol`.

    Returns
    -------
    GrownBones
        Bones and poses, which are the same for every posture.

    Raises
    ------
    InputError
        If no pose gives the JSW, or if one osteophyte hides another osteophyte.
    """
    prepare_template_bones(bone_parameters)
    femur = grow_femur_osteophytes(bone_parameters, knee.osteophytes)
    tibia = grow_tibia_osteophytes(bone_parameters, knee.osteophytes)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda bone: bone.deformed_vertices_mm, (femur, tibia)))
    defined = solve_pose(knee, bone_parameters, femur, tibia, protocol)
    grown = GrownBones(
        jsw_protocol=protocol,
        bone_parameters=bone_parameters,
        femur=femur,
        tibia=tibia,
        jsw_pose=defined,
        straight_pose=defined,
    )
    straight = _flex(grown, 0.0)
    # The femur is tilted to reach the JSW. The valgus angle of its shaft compensates for the tilt, so `varus_deg`
    # remains the angle between the shafts of a straight leg.
    valgus_deg = bone_parameters.femur_valgus_deg + straight.tilt_deg
    return replace(grown, bone_parameters=replace(bone_parameters, femur_valgus_deg=valgus_deg), straight_pose=straight)


def pose_knee(knee: Knee, grown: GrownBones, posture: Posture) -> KneeAssembly:
    """Move the bones of a knee into a posture.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    grown : GrownBones
        Bones of this knee, from `grow_bones`.
    posture : Posture
        Posture of the leg.

    Returns
    -------
    KneeAssembly
        Bones and their pose.

    Raises
    ------
    InputError
        If the femur cannot rest on the tibia in this flexion.
    """
    pose = replace(
        _flex(grown, posture.flexion_deg) if posture.flexion_deg else grown.straight_pose,
        rotation_deg=knee.rotation_deg + posture.rotation_deg,
        forward_deg=posture.tibia_forward_deg,
        lean_deg=grown.jsw_pose.lean_deg - posture.tilt_deg + grown.jsw_protocol.tilt_deg,
    )
    mirror = (1.0 if knee.side == "right" else -1.0, posture.mirror_y, 1.0)
    turn = None if posture.is_frontal else rotation_matrix(*posture.view_rotation)
    return KneeAssembly(
        jsw_protocol=grown.jsw_protocol,
        jsw_pose=grown.jsw_pose,
        posture=posture,
        bone_parameters=grown.bone_parameters,
        femur=grown.femur,
        tibia=grown.tibia,
        pose=pose,
        mirror=mirror,
        view_rotation=turn,
    )


def _flex(grown: GrownBones, flexion_deg: float) -> Pose:
    """Flex the leg from the pose that defines the JSW to a flexion angle, in degrees."""
    further = flexion_deg - grown.jsw_protocol.flexion_deg
    if not further:
        return grown.jsw_pose
    vertices = (
        scale_and_lean_femur(grown.femur.deformed_vertices_mm, grown.bone_parameters),
        scale_slope_and_lean_tibia(grown.tibia.deformed_vertices_mm, grown.bone_parameters),
    )
    return flex_pose(grown.jsw_pose, *vertices, grown.bone_parameters.half_ml_mm, further)
