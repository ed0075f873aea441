"""Subluxation: a pose with a medial or lateral shift of the femur on the tibia."""

from dataclasses import dataclass

from ...core.checks import Array
from ..meshing.rigid_pose import Pose


@dataclass(frozen=True)
class SubluxedPose(Pose):
    """Pose of the bones of a right leg with subluxation.

    Attributes
    ----------
    medial_shift_mm : float
        Medial shift of the femur on the tibia, in mm; lateral if negative.

    See Also
    --------
    Pose : Describes all other attributes.
    """

    medial_shift_mm: float = 0.0

    def femur_to_tibia_transform(self) -> Array:
        """Compute the transform of the femur into the frame of the tibia, with the subluxation.

        Returns
        -------
        (3, 4) float64 array
            Rotation and translation (mm).
        """
        matrix = super().femur_to_tibia_transform()
        matrix[0, 3] += self.medial_shift_mm
        return matrix
