"""KneeAssembly: how the bones of a knee stand in a posture, with the joint spaces that the knee asks for."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..geometry.mesh import Mesh
from ..model.knee import Knee
from ..model.protocol import Posture, Protocol, load_protocol
from .bone_build import Build, formed_femur_stood, formed_tibia_stood, stand_femur, stand_tibia
from .bones import grown_femur, grown_tibia, prepare
from .flexion import flexed
from .osteophytes import BoneWithOsteophytes
from .pose import Pose, moved, rotation
from .spaces import solve_pose


@dataclass(frozen=True, kw_only=True)
class KneeAssembly:
    """A knee's build, its outer femur and tibia at the mean man's size, and where they go.

    defined_under  the protocol that its joint spaces are defined under
    defined        how its bones stand for that protocol
    posture        that it stands in
    mirror         (x, y, z) factors of +1 or -1: a left knee is mirrored in x, one with the detector before it in y
    turn           (3, 3)  last turn of the leg, before it is mirrored; None where it is seen from the front
    """

    defined_under: Protocol
    defined: Pose
    posture: Posture
    build: Build
    femur: BoneWithOsteophytes
    tibia: BoneWithOsteophytes
    pose: Pose
    mirror: tuple[float, float, float]
    turn: Array | None = None

    def femur_mm(self, points: Array) -> Array:
        """(n, 3)  places of the mean man's femur in the leg as it stands

        points  (n, 3)  mm
        """
        return moved(stand_femur(points, self.build), self.pose.femur())

    def tibia_mm(self, points: Array) -> Array:
        """(n, 3)  places of the mean man's tibia in the leg as it stands

        points  (n, 3)  mm
        """
        return moved(stand_tibia(points, self.build), self.pose.tibia())

    def outer_femur_mm(self) -> Array:
        """(n, 3)  vertices of the outer femur in the leg as it stands"""
        return moved(formed_femur_stood(self.femur.formed, self.build), self.pose.femur())

    def outer_tibia_mm(self) -> Array:
        """(n, 3)  vertices of the outer tibia in the leg as it stands, before it is worn"""
        return moved(formed_tibia_stood(self.tibia.formed, self.build), self.pose.tibia())

    def turned(self, points: Array) -> Array:
        """(n, 3)  places of a leg that stands where the posture turns them, mm

        points  (n, 3)  mm
        """
        return points if self.turn is None else points @ self.turn.T

    def seen(self, points: Array) -> Array:
        """(n, 3)  places of a right leg that stands where the detector sees them: turned and mirrored, mm

        points  (n, 3)  mm
        """
        return self.turned(points) * self.mirror

    def mirrored(self, mesh: Mesh) -> Mesh:
        """A mesh turned, as it is in the mirror, wound outward again."""
        faces = mesh.faces if np.prod(self.mirror) > 0 else np.ascontiguousarray(mesh.faces[:, ::-1])
        return Mesh(self.seen(mesh.vertices), faces)


_DEFINED_UNDER = {"projected": "reference", "read": "fixed_flexion"}


def defining_protocol(knee: Knee) -> Protocol:
    """What a knee's joint spaces are defined under, by its `jsw_as`."""
    return load_protocol(_DEFINED_UNDER[knee.jsw_as])


def assemble(knee: Knee, build: Build, posture: Posture, protocol: Protocol) -> KneeAssembly:
    """How a knee stands.

    build     of `build_of`
    posture   in which it stands
    protocol  of `defining_protocol`
    raises    InputError if the joint spaces cannot be met
    """
    prepare(build)
    femur, tibia = grown_femur(build, knee.osteophytes), grown_tibia(build, knee.osteophytes)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda bone: bone.formed, (femur, tibia)))
    defined = solve_pose(knee, build, femur, tibia, protocol)

    def at(flexion_deg: float) -> Pose:
        further = flexion_deg - protocol.flexion_deg
        if not further:
            return defined
        vertices = formed_femur_stood(femur.formed, build), formed_tibia_stood(tibia.formed, build)
        return flexed(defined, *vertices, build.half_ml_mm, further)

    # The femur's tilt closes the joint; its shaft gives that tilt back, so that varus_deg is the angle of the shafts of
    # a straight leg.
    straight = at(0.0)
    build = replace(build, femur_valgus_deg=build.femur_valgus_deg + straight.tilt_deg)
    pose = replace(
        at(posture.flexion_deg) if posture.flexion_deg else straight,
        rotation_deg=knee.rotation_deg + posture.rotation_deg,
        forward_deg=posture.tibia_forward_deg,
        lean_deg=defined.lean_deg - posture.tilt_deg + protocol.tilt_deg,
    )
    mirror = (1.0 if knee.side == "right" else -1.0, posture.mirror_y, 1.0)
    turn = None if posture.is_frontal else rotation(*posture.turn)
    return KneeAssembly(
        defined_under=protocol,
        defined=defined,
        posture=posture,
        build=build,
        femur=femur,
        tibia=tibia,
        pose=pose,
        mirror=mirror,
        turn=turn,
    )
