"""Unevenness: how a person's cortex swells and fades along a bone, which a mean thickness does not say."""

import numpy as np

from ..core.checks import Array
from ..data.bones import Unevenness

# Waves whose sum is the unevenness: so many that its values are about normal.
_WAVES = 32
# Values beyond so many standard deviations are cut.
MOST_SD = 2.0


def uneven_share(points: Array, thickness_mm: Array, table: Unevenness, seed: int, bone: str) -> Array:
    """(n,)  thickness of the cortex at places over its mean there, the same for the same seed and bone

    points        (n, 3)  of the mean man's bone, mm
    thickness_mm  (n,)    mean thickness there; thin shells are uneven by a larger part of it
    seed          of the knee's texture
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(101, *bone.encode())))
    ways = rng.standard_normal((_WAVES, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    lengths_mm = np.exp(rng.uniform(np.log(table.shortest_mm), np.log(table.longest_mm), _WAVES))
    phases = rng.uniform(0, 2 * np.pi, _WAVES)
    waves = np.cos(points @ (ways * (2 * np.pi / lengths_mm)[:, None]).T + phases)
    noise = waves.sum(axis=1) * np.sqrt(2 / _WAVES)
    share = 1 + table.sd * np.minimum(1.0, table.thin_mm / thickness_mm) * np.clip(noise, -MOST_SD, MOST_SD)
    return np.asarray(np.maximum(share, np.minimum(1.0, table.least_mm / thickness_mm)))
