"""Bend: a straight limb as it is bent behind the knee, along an arc that keeps its thickness."""

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array, InputError

# Of the mean man: about here the limb bends, as its femur does; and the length of the arc, where its front stretches.
_PIVOT_Y_MM, _PIVOT_Z_MM, _ARC_MM = 4.0, 23.0, 140.0
# Up to the first flexion a limb is sheared, level by level, which is nearly the same and thins it by its cosine; from
# the second on it is bent (`sheared_deg`).
_SHEARED_TO_DEG, _BENT_FROM_DEG = 40.0, 45.0
# Longest side of a triangle that is bent; the arc is then off its chord by less than the fascia is thick.
_SIDE_MM = 9.0
# Behind the knee skin keeps at least such a share of the arc's radius from its centre, where it would fold.
_LEAST_RADIUS = 0.1


def sheared_deg(flexion_deg: float) -> float:
    """Of a flexion what the sections of a limb follow by moving back; the rest bends it."""
    left = (_BENT_FROM_DEG - flexion_deg) / (_BENT_FROM_DEG - _SHEARED_TO_DEG)
    return flexion_deg if flexion_deg <= _SHEARED_TO_DEG else _SHEARED_TO_DEG * max(0.0, left)


@dataclass(frozen=True, kw_only=True)
class Bend:
    """An arc in the plane of y and z, towards +y; below it a limb stays, above it it goes on straight.

    angle_deg  by which the limb is bent; 0 is not at all
    scale      of the bones
    """

    angle_deg: float
    scale: float

    @property
    def _radius_mm(self) -> float:
        return float(_ARC_MM * self.scale / np.deg2rad(self.angle_deg))

    @property
    def _centre_mm(self) -> Array:
        """y and z of the middle of the arc: both straight parts point at the pivot."""
        half = np.deg2rad(self.angle_deg) / 2
        y, z = _PIVOT_Y_MM * self.scale, _PIVOT_Z_MM * self.scale
        return np.array([y + self._radius_mm, z - self._radius_mm * np.tan(half)])

    def bent(self, points: Array) -> Array:
        """(n, 3)  places of a straight limb where they are in the bent one

        points  (n, 3)  mm
        """
        if not self.angle_deg:
            return points
        (y, z), radius = self._centre_mm, self._radius_mm
        along = points[:, 2] - z
        turn = np.clip(along / radius, 0.0, np.deg2rad(self.angle_deg))
        out, beyond = y - points[:, 1], along - turn * radius
        moved = points.copy()
        moved[:, 1] = y - out * np.cos(turn) + beyond * np.sin(turn)
        moved[:, 2] = z + out * np.sin(turn) + beyond * np.cos(turn)
        return moved

    def straight(self, points: Array) -> Array:
        """(n, 3)  places of the bent limb where they are in the straight one; the inverse of `bent`

        points  (n, 3)  mm; before the middle of the arc
        """
        if not self.angle_deg:
            return points
        (y, z), radius = self._centre_mm, self._radius_mm
        turn = np.clip(np.arctan2(points[:, 2] - z, y - points[:, 1]), 0.0, np.deg2rad(self.angle_deg))
        back, up = y - points[:, 1], points[:, 2] - z
        moved = points.copy()
        moved[:, 1] = y - (back * np.cos(turn) + up * np.sin(turn))
        moved[:, 2] = z + turn * radius + (up * np.cos(turn) - back * np.sin(turn))
        return moved

    def solid(self, straight: Manifold, name: str) -> Manifold:
        """A solid bent; itself where there is no bend.

        raises  InputError where it would fold upon itself behind the knee
        """
        if not self.angle_deg:
            return straight
        far_mm = straight.bounding_box()[4] - self._centre_mm[0]
        if far_mm > -_LEAST_RADIUS * self._radius_mm:
            raise InputError(
                f"flexion = {self.angle_deg:g} deg: {name} would fold behind the knee, where the limb is thicker by "
                f"{far_mm + _LEAST_RADIUS * self._radius_mm:.0f} mm than it can be bent; allowed: less flexion, or a "
                "smaller limb_ap_mm"
            )
        return straight.refine_to_length(_SIDE_MM).warp_batch(lambda points: self.bent(np.array(points)))


def bend_of(flexion_deg: float, scale: float) -> Bend:
    """By which a limb is bent in a flexion, beyond what its sections follow."""
    return Bend(angle_deg=flexion_deg - sheared_deg(flexion_deg), scale=scale)
