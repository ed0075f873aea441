"""Tissues left out: change of the image if a soft tissue is replaced by muscle, compared with the quantum noise."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...anatomy import build
from ...geometry.scene import Scene
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...simulation import simulate
from ..raycasting.raycast_engines import Row
from .throughput import sample_numbered_knee

# Surfaces of each tissue. Outside every surface is muscle, so the volume of a surface that is left out becomes muscle.
_TISSUES = {
    "patellar cartilage": ("patella_cartilage",),
    "tendons": ("patellar_tendon", "quadriceps_tendon"),
    "menisci": ("medial_meniscus", "lateral_meniscus"),
    "infrapatellar fat pad": ("fat_pad",),
    "fat between muscles": ("intermuscular_fat",),
}
# Numbers of rows and columns of the radiographs.
_MATRICES = (512, 2048)
# Tube load of the compared noise, in mAs.
_TUBE_LOAD_MAS = 20.0
# Seed of the noise.
_SEED = 59


def measure_left_out_tissues(knees: int) -> list[Row]:
    """Measure how a radiograph changes if a soft tissue is replaced by muscle.

    Parameters
    ----------
    knees : int
        Number of knees, sampled from the grade table ``population`` with KL grades 0 to 4 in turn.

    Returns
    -------
    list of dict
        One row per matrix and tissue: median and maximum over the knees of the RMS change of the logarithm of the pixel
        values, the largest change of a pixel, and the median RMS of the quantum noise at 20 mAs on the same scale. The
        protocol is ``fixed_flexion``.
    """
    rows: list[Row] = []
    drawn = [sample_numbered_knee(number)[0] for number in range(knees)]
    for matrix in _MATRICES:
        protocol = replace(load_protocol("fixed_flexion").resample(matrix), mas=_TUBE_LOAD_MAS)
        changes: dict[str, list[tuple[float, float]]] = {tissue: [] for tissue in ("quantum noise", *_TISSUES)}
        for knee in drawn:
            for tissue, change in _measure_knee(knee, protocol).items():
                changes[tissue].append((float(np.sqrt((change**2).mean())), float(np.abs(change).max())))
        noise_rms = float(np.median([rms for rms, _ in changes.pop("quantum noise")]))
        for tissue, pairs in changes.items():
            rms, largest = np.array(pairs).T
            rows.append({
                "matrix": matrix, "tissue": tissue, "knees": knees, "median_rms": round(float(np.median(rms)), 5),
                "max_rms": round(float(rms.max()), 5), "largest": round(float(largest.max()), 4),
                "noise_rms": round(noise_rms, 5),
            })  # fmt: skip
    return rows


def _measure_knee(knee: Knee, protocol: Protocol) -> dict[str, NDArray[np.float64]]:
    """Return the change (rows, cols) of the logarithm of the pixel values due to noise and to each missing tissue."""
    built = build(knee, protocol)
    protocol = built.aim_beam(protocol)
    whole = _simulate_log(built.scene, replace(protocol, noise="none"))
    changes = {"quantum noise": _simulate_log(built.scene, protocol) - whole}
    for tissue, names in _TISSUES.items():
        rest = _leave_out(built.scene, names)
        changes[tissue] = _simulate_log(rest, replace(protocol, noise="none")) - whole
    return changes


def _leave_out(scene: Scene, names: Collection[str]) -> Scene:
    """Return a scene without the surfaces of the given names."""
    return replace(scene, surfaces=tuple(surface for surface in scene.surfaces if surface.name not in names))


def _simulate_log(scene: Scene, protocol: Protocol) -> NDArray[np.float64]:
    """Simulate a radiograph and return the logarithm of its pixel values (rows, cols)."""
    radiograph = simulate(scene, protocol, rng=_SEED, engine="scanline", workers=1)
    return np.log(np.maximum(radiograph.pixels, 1).astype(np.float64))
