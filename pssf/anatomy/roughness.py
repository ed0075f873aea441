"""How places of a bone are moved: by ridges and pits where it bears no cartilage, its faint lines on films; by what
of a person's form the modes of shape are too coarse for; by growth.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..data.bones import GrowthZone, RoughZone
from .noise import noise

# No place is moved by more standard deviations.
_MOST_SD = 2.0


class Seeds(NamedTuple):
    """Of a knee's texture, and of what of its form the modes of shape are too coarse for."""

    texture: int
    form: int


NO_SEEDS = Seeds(0, 0)


def roughness(points: Array, zones: tuple[RoughZone, ...], seeds: Seeds, end: int) -> Array:
    """(n, 3)  by how much places of a bone are moved, mm; nothing outside its zones, and smoothly more within

    points  (n, 3)  of the mean man's bone, mm
    end     +1 of the femur, -1 of the tibia
    """
    moves = np.zeros_like(points)
    for number, zone in enumerate(zones):
        within = 1.0 - _from_middle(points, zone)
        some = np.flatnonzero(within > 0)
        if not len(some):
            continue
        seed = getattr(seeds, zone.of)
        waves = noise(points[some], zone.lengths_mm, seed, (102, end + 1, number)).clip(-_MOST_SD, _MOST_SD)
        moves[some] += (zone.sd_mm * within[some] ** 2 * waves)[:, None] * np.array(zone.way)
    return moves


def growth(points: Array, zones: tuple[GrowthZone, ...], grown_mm: float) -> Array:
    """(n, 3)  by how much places of a bone are moved where it has grown, mm; nothing outside the zones

    points  (n, 3)  of the mean man's bone, mm
    """
    moves = np.zeros_like(points)
    for zone in zones if grown_mm else ():
        within = np.maximum(1.0 - _from_middle(points, zone), 0.0)
        moves += (grown_mm * within**2)[:, None] * np.array(zone.way)
    return moves


def in_zones(points: Array, zones: tuple[RoughZone, ...]) -> NDArray[np.bool_]:
    """(n,)  whether places of the mean man's bone may be moved

    points  (n, 3)  mm
    """
    return np.any([_from_middle(points, zone) < 1 for zone in zones] or [np.zeros(len(points), bool)], axis=0)


def _from_middle(points: Array, zone: RoughZone | GrowthZone) -> Array:
    """(n,)  squared way from a zone's middle over that to its edge"""
    x, y, z = (((points[:, axis] - zone.centre[axis]) / zone.half[axis]) ** 2 for axis in range(3))
    return np.asarray(x + y + z)
