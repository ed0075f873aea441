"""Rigid pose: rigid transforms of the bones of a leg."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ...core.checks import Array

# Largest external rotation of the femur on the tibia, in degrees. Most of this rotation, 5 to 10 degrees, occurs in the
# first 30 degrees of flexion (Johal et al. 2005, from memory). On fixed-flexion radiographs of patients, the fibula is
# therefore visible beside the tibia, and the femur is equally bright laterally and medially.
_OUT_DEG = 9.5
# Flexion at which the external rotation reaches 1 - 1/e (63 %) of its largest value, in degrees.
_BY_DEG = 25.0
# Medial shift of the femur per degree of external rotation, in mm. Without the shift, condyles, notch and edges deviate
# by 0.9 mm from landmarks on 150 fixed-flexion radiographs with KL grade 0 (Tiulpin et al. 2019; landmarks.toml).
_MEDIAL_MM_PER_DEG = 0.16


@dataclass(frozen=True)
class Pose:
    """Pose of the bones of a right leg.

    The femur is flexed, tilted and raised on the tibia. Both bones are then shifted, and the whole leg is rotated about
    z, y and x in this order.

    Attributes
    ----------
    tilt_deg : float
        Rotation of the femur on the tibia about y, in degrees. A positive tilt lowers the medial condyle.
    raise_mm : float
        Upward shift of the femur on the tibia along z, in mm.
    shift_mm : float
        Upward shift of all bones along z, in mm.
    flexion_deg : float
        Flexion of the femur on the tibia, in degrees.
    rotation_deg : float
        Rotation of the whole leg about z, in degrees.
    pivot_mm : (float, float, float)
        Point in the frame of the femur about which the femur flexes, in mm.
    rollback_mm : float
        Posterior shift of the femur on the tibia, in mm.
    lean_deg : float
        Rotation of the whole leg about y, in the plane of the detector, in degrees.
    forward_deg : float
        Rotation of the whole leg about x after all other rotations, in degrees. A positive value moves the foot
        backwards.
    """

    tilt_deg: float
    raise_mm: float
    shift_mm: float
    flexion_deg: float
    rotation_deg: float
    pivot_mm: tuple[float, float, float]
    rollback_mm: float = 0.0
    lean_deg: float = 0.0
    forward_deg: float = 0.0

    def femoral_external_rotation_deg(self) -> float:
        """Compute the external rotation of the femur on the tibia.

        Returns
        -------
        float
            Angle in degrees; it increases with flexion and is 0 in extension.
        """
        return _OUT_DEG * (1.0 - math.exp(-max(self.flexion_deg, 0.0) / _BY_DEG))

    def femur_transform(self) -> Array:
        """Compute the transform of the femur into the knee frame.

        Returns
        -------
        (3, 4) float64 array
            Rotation and translation (mm).
        """
        return self._transform_to_knee(self.femur_to_tibia_transform())

    def femur_to_tibia_transform(self) -> Array:
        """Compute the transform of the femur into the frame of the tibia.

        Returns
        -------
        (3, 4) float64 array
            Rotation and translation (mm).
        """
        flex = rotation_matrix(2, -self.femoral_external_rotation_deg()) @ rotation_matrix(0, -self.flexion_deg)
        pivot = np.asarray(self.pivot_mm)
        matrix = np.column_stack((flex, pivot - flex @ pivot))
        matrix = rotation_matrix(1, self.tilt_deg) @ matrix
        matrix[:, 3] += _MEDIAL_MM_PER_DEG * self.femoral_external_rotation_deg(), self.rollback_mm, self.raise_mm
        return matrix

    def tibia_transform(self) -> Array:
        """Compute the transform of tibia and fibula into the knee frame.

        Returns
        -------
        (3, 4) float64 array
            Rotation and translation (mm).
        """
        return self._transform_to_knee(np.eye(3, 4))

    def soft_tissue_transform(self) -> Array:
        """Compute the transform of the soft tissue into the knee frame.

        Returns
        -------
        (3, 4) float64 array
            Rotation without translation. The soft tissue follows half of the external rotation of the femur.
        """
        halfway = replace(self, rotation_deg=self.rotation_deg - self.femoral_external_rotation_deg() / 2)
        return np.column_stack((halfway._leg_rotation(), np.zeros(3)))

    def _transform_to_knee(self, matrix: Array) -> Array:
        """Apply the shift and the rotation of the leg to a transform (3, 4)."""
        moved = matrix.copy()
        moved[2, 3] += self.shift_mm
        return self._leg_rotation() @ moved

    def _leg_rotation(self) -> Array:
        """Compute the rotation (3, 3) of the whole leg."""
        return (
            rotation_matrix(0, self.forward_deg)
            @ rotation_matrix(1, self.lean_deg)
            @ rotation_matrix(2, self.rotation_deg)
        )


def adjust_femur_pose(pose: Pose, x: Array, raise_mm: Array) -> Pose:
    """Tilt and raise the femur so that it moves upwards by a specified distance at each of two positions along x.

    Parameters
    ----------
    pose : Pose
        Pose to adjust.
    x : (2,) float64 array, mm
        The two positions along x at which the upward shift is specified.
    raise_mm : (2,) float64 array
        Required upward shift of the femur at each position in `x`, in mm.

    Returns
    -------
    Pose
        Pose with adjusted `tilt_deg` and `raise_mm`.
    """
    # A small tilt dB about y lowers a point at x by x dB (right-handed rotation: z' = -x sin B + z cos B).
    lift, turn = np.linalg.solve([[1.0, -x[0]], [1.0, -x[1]]], raise_mm)
    return replace(pose, tilt_deg=pose.tilt_deg + float(np.rad2deg(turn)), raise_mm=pose.raise_mm + float(lift))


def rotation_matrix(axis: int, degrees: float) -> Array:
    """Compute the matrix of a right-handed rotation about a coordinate axis.

    Parameters
    ----------
    axis : int
        0, 1 or 2 for x, y or z.
    degrees : float
        Angle in degrees.

    Returns
    -------
    (3, 3) float64 array
        Rotation matrix.
    """
    angle = np.deg2rad(degrees)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix


def compose_transforms(first: Array, second: Array) -> Array:
    """Compose two transforms.

    Parameters
    ----------
    first : (3, 4) float64 array, mm
        Transform that is applied first.
    second : (3, 4) float64 array, mm
        Transform that is applied second.

    Returns
    -------
    (3, 4) float64 array
        Composed transform: rotation and translation (mm).
    """
    return np.column_stack((second[:, :3] @ first[:, :3], apply_transform(first[None, :, 3], second)[0]))


def apply_transform(vertices_mm: Array, transform: Array) -> Array:
    """Apply a transform to points.

    Parameters
    ----------
    vertices_mm : (n, 3) float64 array
        Points, in mm.
    transform : (3, 4) float64 array, mm
        Rotation and translation.

    Returns
    -------
    (n, 3) float64 array
        Transformed points, in mm.
    """
    return vertices_mm @ transform[:, :3].T + transform[:, 3]
