"""Unevenness: how a person's cortex swells and fades along a bone, which a mean thickness does not say."""

import numpy as np

from ..core.checks import Array
from ..data.bones import Unevenness
from .noise import noise

# Values beyond so many standard deviations are cut.
MOST_SD = 2.0


def uneven_share(points: Array, thickness_mm: Array, table: Unevenness, seed: int, bone: str) -> Array:
    """(n,)  thickness of the cortex at places over its mean there, the same for the same seed and bone

    points        (n, 3)  of the mean man's bone, mm
    thickness_mm  (n,)    mean thickness there; thin shells are uneven by a larger part of it
    seed          of the knee's texture
    """
    lengths_mm = (table.shortest_mm, table.longest_mm)
    waves = noise(points, lengths_mm, seed, (101, *bone.encode())).clip(-MOST_SD, MOST_SD)
    share = 1 + table.sd * np.minimum(1.0, table.thin_mm / thickness_mm) * waves
    return np.asarray(np.maximum(share, np.minimum(1.0, table.least_mm / thickness_mm)))
