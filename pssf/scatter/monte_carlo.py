"""Scatter by following photons one by one: slow, and what the fast kernel is calibrated against."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.blocks import enlarge
from ..core.checks import Array, require_seed, require_whole, require_workers
from ..geometry.scene import Scene
from ..geometry.view import View
from ..xray.collimator import field_half_mm
from ..xray.materials import attenuation_per_mm
from ..xray.spectrum import beam_of
from ..xray.technique import Technique
from .interactions import CUT_OFF_KEV, interactions_of
from .transport import Setting, follow
from .voxels import Voxels, voxels_of

_COARSE_MM = 8.0
# Standard deviation of the Gaussian that takes noise out of the map, in cells.
_SMOOTH_CELLS = 1.0
_VOXEL_MM = 2.0
_MOST_VOXELS = 10e6
# Work is cut into as many pieces, whatever the workers; the spread between them gives the error.
_BATCHES = 32
# Stream below the seed, beside those of shape, pose and noise.
_STREAM = 4
# Energies are drawn half by what they would leave in the panel, half by what of it passes so much muscle.
_TYPICAL_MM = 60.0


@dataclass(frozen=True, kw_only=True)
class Counts:
    """What came of the photons.

    primary_kev, scatter_kev  (batches, rows, cols)  energy absorbed by the panel in each cell, keV in all of the mAs;
                              the mean of the batches is the estimate, their spread its error
    pixels                    (rows, cols)  pixels in a cell; those at the lower and right edge may have fewer
    step                      pixels along the side of a cell
    energy_kev                (4,)  emitted, absorbed in the scene, fallen on the field, gone past it
    """

    primary_kev: Array
    scatter_kev: Array
    pixels: Array
    step: int
    energy_kev: Array


def scatter_monte_carlo(
    scene: Scene, technique: Technique, *, photons: int = 20_000_000, seed: int = 0, workers: int = 2
) -> tuple[NDArray[np.float32], float]:
    """Scatter by Monte Carlo, in the units of `scatter.scatter_kev`, and how sure it is.

    What is irradiated is the collimator's field on the detector (`xray.collimator`), with sharp edges.
    photons  aimed at what the field sees of the scene; the error falls as the root of their number
    seed     the same seed gives the same bytes on any number of workers
    returns  (rows, cols)  mean energy absorbed from scattered photons, keV a pixel, smoothed over 8 mm; and its
             statistical error, root mean square over the field, relative to its mean
    raises   InputError for a scene that cannot be traced, an unknown material or a number out of range
    """
    counts = count(scene, technique, photons=photons, seed=seed, workers=workers)
    # The same for each batch, so that their spread is that of the smoothed map.
    maps = np.array([_smooth(batch) for batch in counts.scatter_kev]) / _smooth(counts.pixels)
    mean, error = maps.mean(axis=0), maps.std(axis=0, ddof=1) / np.sqrt(len(maps))
    relative = float(np.sqrt(np.mean(error**2)) / mean.mean()) if mean.any() else 0.0
    return enlarge(mean, counts.step, (technique.view.rows, technique.view.cols)), relative


def count(
    scene: Scene,
    technique: Technique,
    *,
    photons: int,
    seed: int = 0,
    workers: int = 2,
    cell_mm: float = _COARSE_MM,
    voxel_mm: float | None = None,
) -> Counts:
    """Follow photons from the source of a technique through a scene to its detector.

    Between source, scene and detector is vacuum. The source is a point without heel effect; every material has its own
    density throughout. Arguments as `scatter_monte_carlo`.
    cell_mm   wanted side of a cell; it is a whole number of pixels
    voxel_mm  by default 2 mm, or more for a scene of over 10 million voxels
    """
    require_whole("photons", photons, _BATCHES, 10**12, "")
    require_seed(seed)
    require_workers(workers)
    view, step = technique.view, max(1, round(cell_mm / technique.view.pixel_mm))
    voxels = _before_the_detector(scene, view, voxel_mm)
    where = _setting(voxels, technique, step * view.pixel_mm)
    what = interactions_of(
        tuple(technique.material(name) for name in voxels.names), float(where.energies.max()), technique.detector
    )
    shape = (-(-view.rows // step), -(-view.cols // step))
    counts, energy = np.zeros((_BATCHES, 2, *shape)), np.zeros((_BATCHES, 4))
    each = -(-photons // _BATCHES)

    def batch(number: int) -> None:
        stream = np.random.SeedSequence(seed, spawn_key=(_STREAM, number)).generate_state(4, np.uint64)
        follow(each, stream.astype(np.uint64), where, what, counts[number], energy[number])

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(batch, range(_BATCHES)))
    # Each photon stands for its share of the window.
    area = float(np.diff(where.window[:2])[0] * np.diff(where.window[2:])[0]) / each
    inside = [np.diff(np.append(np.arange(0, n, step), n)) for n in (view.rows, view.cols)]
    return Counts(
        primary_kev=counts[:, 0] * area,
        scatter_kev=counts[:, 1] * area,
        pixels=np.outer(*inside).astype(np.float64),
        step=step,
        energy_kev=energy.mean(axis=0) * area,
    )


def _before_the_detector(scene: Scene, view: View, voxel_mm: float | None) -> Voxels:
    """The scene between source and detector as voxels."""
    bounds = scene.bounds_mm.copy()
    bounds[:, 1] = np.clip(bounds[:, 1], view.source_mm[1], view.centre_mm[1])
    # A scene that is not between them leaves a thin sheet of what is there.
    bounds[0, 1] = min(bounds[0, 1], bounds[1, 1] - 0.001)
    size = voxel_mm or max(_VOXEL_MM, float(np.prod(np.ptp(bounds, axis=0)) / _MOST_VOXELS) ** (1 / 3))
    return voxels_of(scene, bounds, voxel_mm=size)


def _setting(voxels: Voxels, technique: Technique, cell_mm: float) -> Setting:
    view, beam = technique.view, beam_of(technique)
    kept = beam.energies_kev >= CUT_OFF_KEV
    energies, photons, signal = (v[kept] for v in (beam.energies_kev, beam.photons_per_mm2, beam.signal_kev))
    left = (photons if photons.any() else np.ones_like(photons)) * signal
    passed = left * np.exp(-attenuation_per_mm(technique.material("muscle"), energies) * _TYPICAL_MM)
    # The mixture bounds the weights, in thick parts and in thin ones.
    chance = left / left.sum() / 2 + passed / passed.sum() / 2
    chosen = np.cumsum(chance)
    chosen[-1] = 1.0
    field = _field_mm(view)
    return Setting(
        source=np.array(view.source_mm),
        plane=view.centre_mm[1],
        window=_window_mm(voxels, view, _lit_mm(technique, field)),
        field=np.array([*field, cell_mm]),
        energies=energies,
        chosen=chosen,
        weights=photons / chance,
        material=voxels.index,
        origin=voxels.origin_mm,
        size=voxels.size_mm,
    )


def _field_mm(view: View) -> Array:
    """(4,)  x from, x to, z from, z to of the detector, with the whole of its outer pixels"""
    half_x, half_z = view.cols * view.pixel_mm / 2, view.rows * view.pixel_mm / 2
    x, _, z = view.centre_mm
    return np.array([x - half_x, x + half_x, z - half_z, z + half_z])


def _lit_mm(technique: Technique, field: Array) -> Array:
    """(4,)  as `field`: what the collimator, whose edges are sharp here, leaves of it"""
    x, _, z = technique.view.centre_mm
    half_x, half_z = field_half_mm(technique)
    lit = np.array([x - half_x, x + half_x, z - half_z, z + half_z])
    return np.where([1, 0, 1, 0], np.maximum(lit, field), np.minimum(lit, field))


def _window_mm(voxels: Voxels, view: View, field: Array) -> Array:
    """(4,)  as `field`: the part of the detector that lies in the shadow of the grid"""
    source, corners = np.array(view.source_mm), np.array([voxels.origin_mm, voxels.upper_mm])
    depth = (corners[:, 1] - source[1]) / (view.centre_mm[1] - source[1])
    if depth.min() < 1e-6:
        return field
    window = field.copy()
    for axis, low in ((0, 0), (2, 2)):
        shadow = source[axis] + np.subtract.outer(corners[:, axis], source[axis]) / depth[:, None]
        window[low : low + 2] = np.clip([shadow.min(), shadow.max()], field[low], field[low + 1])
    empty = window[0] >= window[1] or window[2] >= window[3]
    return field if empty else window


def _smooth(cells: Array) -> Array:
    """(rows, cols)  cells shared out among their neighbours; nothing comes from outside the field"""
    return np.asarray(ndimage.gaussian_filter(cells, _SMOOTH_CELLS, mode="constant"))
