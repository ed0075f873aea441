"""Pose: where the bones of a leg go, as rigid transforms."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array

# A flexed femur turns outwards on the tibia, most of it in the first 30 degrees, 5 to 10 there (Johal and others
# 2005, from memory): so much at most, and two thirds of it at the second. On fixed-flexion films it shows by fibulae
# beside the tibia, and by a femur as bright laterally as medially.
_OUT_DEG, _BY_DEG = 9.5, 25.0
# Doing so it comes to stand so far to medial, mm a degree: condyles, notch and edges of 150 fixed-flexion films of KL 0
# (Tiulpin and others 2019; landmarks.toml) are 0.9 mm from where a turn about the middle leaves them.
_MEDIAL_MM_PER_DEG = 0.16


@dataclass(frozen=True)
class Pose:
    """Where the bones go: the femur is flexed, tilted about y and raised; all is then moved, turned about z and leant.

    back_mm      by which the femur has rolled back on the tibia
    lean_deg     of the whole leg about y, in the plane of the film
    forward_deg  of the whole leg about x, its foot backwards, after all else
    """

    tilt_deg: float
    raise_mm: float
    shift_mm: float
    flexion_deg: float
    rotation_deg: float
    pivot_mm: tuple[float, float, float]
    back_mm: float = 0.0
    lean_deg: float = 0.0
    forward_deg: float = 0.0

    def femur_out_deg(self) -> float:
        """Turn of the femur on the tibia, outwards"""
        return _OUT_DEG * (1.0 - math.exp(-max(self.flexion_deg, 0.0) / _BY_DEG))

    def femur(self) -> Array:
        """(3, 4)  transform of the femur into the knee frame"""
        return self._leg(self.femur_on_tibia())

    def femur_on_tibia(self) -> Array:
        """(3, 4)  transform of the femur into the tibia's frame"""
        flex = rotation(2, -self.femur_out_deg()) @ rotation(0, -self.flexion_deg)
        pivot = np.asarray(self.pivot_mm)
        matrix = np.column_stack((flex, pivot - flex @ pivot))
        matrix = rotation(1, self.tilt_deg) @ matrix
        matrix[:, 3] += _MEDIAL_MM_PER_DEG * self.femur_out_deg(), self.back_mm, self.raise_mm
        return matrix

    def tibia(self) -> Array:
        """(3, 4)  transform of tibia and fibula into the knee frame"""
        return self._leg(np.eye(3, 4))

    def soft(self) -> Array:
        """(3, 4)  transform of the soft tissue into the knee frame; it turns half as far as the femur does"""
        halfway = replace(self, rotation_deg=self.rotation_deg - self.femur_out_deg() / 2)
        return np.column_stack((halfway._turned(), np.zeros(3)))

    def _leg(self, matrix: Array) -> Array:
        moved = matrix.copy()
        moved[2, 3] += self.shift_mm
        return self._turned() @ moved

    def _turned(self) -> Array:
        return rotation(0, self.forward_deg) @ rotation(1, self.lean_deg) @ rotation(2, self.rotation_deg)


def turned_by(pose: Pose, x: Array, raise_mm: Array) -> Pose:
    """A pose whose femur is tilted and raised so that places at two x go up by so much each.

    x, raise_mm  (2,)  mm
    """
    # A tilt about y by dB lowers a point at x by x dB (right-handed, z' = -x sin B + z cos B).
    lift, turn = np.linalg.solve([[1.0, -x[0]], [1.0, -x[1]]], raise_mm)
    return replace(pose, tilt_deg=pose.tilt_deg + float(np.rad2deg(turn)), raise_mm=pose.raise_mm + float(lift))


def rotation(axis: int, degrees: float) -> Array:
    """(3, 3)  rotation about x, y or z (0, 1 or 2)"""
    angle = np.deg2rad(degrees)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix


def composed(first: Array, then: Array) -> Array:
    """(3, 4)  one transform after another

    first, then  (3, 4)  mm
    """
    return np.column_stack((then[:, :3] @ first[:, :3], moved(first[None, :, 3], then)[0]))


def moved(vertices_mm: Array, transform: Array) -> Array:
    """(n, 3)  vertices after a (3, 4) transform, mm"""
    return vertices_mm @ transform[:, :3].T + transform[:, 3]
