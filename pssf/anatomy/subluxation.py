"""SubluxedPose: a pose whose femur has slipped off the middle of the tibia, to medial or to lateral."""

from dataclasses import dataclass

from ..core.checks import Array
from .pose import Pose


@dataclass(frozen=True)
class SubluxedPose(Pose):
    """A pose.

    medial_mm  by which the femur lies farther to medial on the tibia, across the tibia
    """

    medial_mm: float = 0.0

    def femur_on_tibia(self) -> Array:
        """(3, 4)  transform of the femur into the tibia's frame"""
        matrix = super().femur_on_tibia()
        matrix[0, 3] += self.medial_mm
        return matrix
