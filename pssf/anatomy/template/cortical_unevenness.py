"""Variation of cortical thickness along a bone, relative to the mean thickness at each point."""

import numpy as np

from ...core.checks import Array
from ...data.anatomy.bone_tables import CorticalThicknessVariation
from ..meshing.wave_noise import compute_wave_noise

# Largest deviation from the mean thickness, in standard deviations. Larger deviations are clipped to this value.
MAX_SD = 2.0


def compute_thickness_factor(
    points: Array, thickness_mm: Array, table: CorticalThicknessVariation, seed: int, bone: str
) -> Array:
    """Compute the local thickness of the cortex relative to its mean thickness at the same point.

    Parameters
    ----------
    points : (n, 3) float64 array, mm
        Points of the template bone.
    thickness_mm : (n,) float64 array
        Mean thickness at the points, in mm. The relative variation is larger where the cortex is thin.
    table : CorticalThicknessVariation
        Magnitude and wavelengths of the variation, and the smallest thickness.
    seed : int
        Texture seed of the knee.
    bone : str
        Name of the bone; every bone of a knee has its own variation.

    Returns
    -------
    (n,) float64 array
        Factor by which the mean thickness is multiplied, dimensionless. The same seed and bone always give the same
        factors.
    """
    lengths_mm = (table.shortest_mm, table.longest_mm)
    waves = compute_wave_noise(points, lengths_mm, seed, (101, *bone.encode())).clip(-MAX_SD, MAX_SD)
    share = 1 + table.sd * np.minimum(1.0, table.thin_mm / thickness_mm) * waves
    return np.asarray(np.maximum(share, np.minimum(1.0, table.least_mm / thickness_mm)))
