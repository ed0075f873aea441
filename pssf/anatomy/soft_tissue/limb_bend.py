"""Bending of the straight limb for a flexed knee, along an arc that preserves the limb thickness."""

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array, InputError

# Posterior coordinate of the flexion axis of limb and femur in the template anatomy, in mm.
_PIVOT_Y_MM = 4.0
# Proximal coordinate of the flexion axis of limb and femur in the template anatomy, in mm.
_PIVOT_Z_MM = 23.0
# Length of the arc along which the limb bends, at template size, in mm.
_ARC_MM = 140.0
# Largest flexion that is modelled entirely by shearing the limb in horizontal slices, in degrees. Shearing approximates
# bending and thins the limb by the cosine of the flexion.
_SHEARED_TO_DEG = 40.0
# Smallest flexion that is modelled entirely by bending the limb, in degrees. Between the largest sheared and the
# smallest bent flexion, the shear decreases linearly.
_BENT_FROM_DEG = 45.0
# Largest edge length of a bent mesh, in mm. The distance between an arc and its chord is then below the fascia
# thickness.
_MAX_EDGE_MM = 9.0
# Smallest distance of the skin behind the knee from the arc centre, as a fraction of the arc radius. At the arc centre,
# the skin would fold.
_MIN_RADIUS_FRACTION = 0.1


def shear_angle_deg(flexion_deg: float) -> float:
    """Return the portion of the flexion angle that is modelled by shearing the limb.

    Bending models the remaining angle.

    Parameters
    ----------
    flexion_deg : float
        Flexion of the femur, in degrees.

    Returns
    -------
    float
        Shear angle, in degrees. It equals the flexion up to 40 degrees and is 0 from 45 degrees.
    """
    left = (_BENT_FROM_DEG - flexion_deg) / (_BENT_FROM_DEG - _SHEARED_TO_DEG)
    return flexion_deg if flexion_deg <= _SHEARED_TO_DEG else _SHEARED_TO_DEG * max(0.0, left)


@dataclass(frozen=True, kw_only=True)
class LimbBend:
    """Arc in the sagittal plane along which a straight limb is bent backwards.

    Below the arc, the limb keeps its shape; above the arc, it continues straight.

    Parameters
    ----------
    angle_deg : float
        Angle by which the limb is bent, in degrees; 0 means a straight limb.
    scale : float
        Size of the bones relative to the template.
    """

    angle_deg: float
    scale: float

    @property
    def _radius_mm(self) -> float:
        """Radius of the arc, in mm."""
        return float(_ARC_MM * self.scale / np.deg2rad(self.angle_deg))

    @property
    def _centre_mm(self) -> Array:
        """Centre (y, z) of the arc, in mm. Both straight segments of the limb are aligned with the flexion axis."""
        half = np.deg2rad(self.angle_deg) / 2
        y, z = _PIVOT_Y_MM * self.scale, _PIVOT_Z_MM * self.scale
        return np.array([y + self._radius_mm, z - self._radius_mm * np.tan(half)])

    def bend_points(self, points: Array) -> Array:
        """Map points of the straight limb to the bent limb.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points of the straight limb, in mm.

        Returns
        -------
        (n, 3) float64 array
            The same points in the bent limb, in mm.
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

    def straighten_points(self, points: Array) -> Array:
        """Map points of the bent limb to the straight limb (inverse of `bend_points`).

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points of the bent limb, in mm, anterior to the centre of the arc.

        Returns
        -------
        (n, 3) float64 array
            The same points in the straight limb, in mm.
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

    def bend_solid(self, straight: Manifold, name: str) -> Manifold:
        """Bend a solid of the straight limb.

        Parameters
        ----------
        straight : Manifold
            Solid of the straight limb, in mm.
        name : str
            Name of the solid in the error message.

        Returns
        -------
        Manifold
            Bent solid, or unchanged `straight` if the angle is 0.

        Raises
        ------
        InputError
            If the solid would fold onto itself behind the knee.
        """
        if not self.angle_deg:
            return straight
        far_mm = straight.bounding_box()[4] - self._centre_mm[0]
        if far_mm > -_MIN_RADIUS_FRACTION * self._radius_mm:
            raise InputError(
                f"flexion must be smaller for this limb, got {self.angle_deg:g} deg: {name} would fold behind the "
                f"knee, where it is {far_mm + _MIN_RADIUS_FRACTION * self._radius_mm:.0f} mm too thick to be bent; "
                "reduce the flexion or use a smaller limb_ap_mm"
            )
        return straight.refine_to_length(_MAX_EDGE_MM).warp_batch(lambda points: self.bend_points(np.array(points)))


def build_limb_bend(flexion_deg: float, scale: float) -> LimbBend:
    """Build the arc that bends the limb by the flexion angle minus the shear angle.

    Parameters
    ----------
    flexion_deg : float
        Flexion of the femur, in degrees.
    scale : float
        Size of the bones relative to the template.

    Returns
    -------
    LimbBend
        Arc that bends the limb by the remaining angle.
    """
    return LimbBend(angle_deg=flexion_deg - shear_angle_deg(flexion_deg), scale=scale)
