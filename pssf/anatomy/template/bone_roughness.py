"""Local displacements of the bone surface: roughness and growth.

Roughness adds ridges and pits where the bone has no cartilage. They appear as faint lines on radiographs. Roughness
also adds shape variation that is too fine for the shape modes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...data.anatomy.bone_tables import GrowthZone, RoughnessZone
from ..meshing.wave_noise import compute_wave_noise

# Largest displacement, in standard deviations. Larger displacements are clipped to this value.
_MAX_SD = 2.0


class Seeds(NamedTuple):
    """Seeds of the roughness of one knee.

    Attributes
    ----------
    texture : int
        Seed of the surface texture.
    form : int
        Seed of the shape variation that is too fine for the shape modes.
    """

    texture: int
    form: int


# Seeds of a bone without roughness zones.
NO_SEEDS = Seeds(0, 0)


def compute_roughness_mm(points: Array, zones: tuple[RoughnessZone, ...], seeds: Seeds, shaft_sign: int) -> Array:
    """Compute by how much surface roughness displaces the points of a bone.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points of the template bone.
    zones : tuple of RoughnessZone
        Zones with a rough surface.
    seeds : Seeds
        Seeds of the knee.
    shaft_sign : int
        +1 for the femur, -1 for the tibia.

    Returns
    -------
    (n, 3) float64 array
        Displacements in mm. They are 0 outside the zones and increase smoothly towards the centre of each zone.
    """
    moves = np.zeros_like(points)
    for number, zone in enumerate(zones):
        within = 1.0 - _compute_squared_zone_distance(points, zone)
        some = np.flatnonzero(within > 0)
        if not len(some):
            continue
        seed = getattr(seeds, zone.seed_stream)
        waves = compute_wave_noise(points[some], zone.lengths_mm, seed, (102, shaft_sign + 1, number)).clip(
            -_MAX_SD, _MAX_SD
        )
        moves[some] += (zone.sd_mm * within[some] ** 2 * waves)[:, None] * np.array(zone.direction)
    return moves


def compute_growth_mm(points: Array, zones: tuple[GrowthZone, ...], bone_growth_mm: float) -> Array:
    """Compute by how much bone growth displaces the points of a bone.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points of the template bone.
    zones : tuple of GrowthZone
        Zones in which bone grows.
    bone_growth_mm : float
        Growth of the bone surface, in mm.

    Returns
    -------
    (n, 3) float64 array
        Displacements in mm; 0 outside the zones.
    """
    moves = np.zeros_like(points)
    for zone in zones if bone_growth_mm else ():
        within = np.maximum(1.0 - _compute_squared_zone_distance(points, zone), 0.0)
        moves += (bone_growth_mm * within**2)[:, None] * np.array(zone.direction)
    return moves


def is_in_zones(points: Array, zones: tuple[RoughnessZone, ...]) -> NDArray[np.bool_]:
    """Test which points of the template bone are inside roughness zones.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points of the template bone.
    zones : tuple of RoughnessZone
        Zones with a rough surface.

    Returns
    -------
    (n,) bool array
        True where roughness can displace the point.
    """
    return np.any(
        [_compute_squared_zone_distance(points, zone) < 1 for zone in zones] or [np.zeros(len(points), bool)], axis=0
    )


def _compute_squared_zone_distance(points: Array, zone: RoughnessZone | GrowthZone) -> Array:
    """Compute the squared normalised distance (n,) from the centre of a zone: 0 at the centre, 1 on the edge."""
    x, y, z = (((points[:, axis] - zone.centre[axis]) / zone.half[axis]) ** 2 for axis in range(3))
    return np.asarray(x + y + z)
