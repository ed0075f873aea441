"""Monte Carlo simulation of scatter: a slow reference method to which the fast scatter kernel is fitted."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import (
    Array,
    require_integer,
    require_seed,
    require_workers,
)
from ..core.resample import upsample_linear
from ..geometry.scene import Scene
from ..geometry.view import View
from ..model.detector import Detector
from ..xray.collimator import field_half_size_mm
from ..xray.materials import attenuation_per_mm
from ..xray.photon_interactions import CUT_OFF_KEV, make_interaction_tables, table_energies_kev
from ..xray.resolved_technique import Technique
from ..xray.scintillator_response import compute_optical_depths, load_scintillator_response
from ..xray.spectrum import compute_beam
from .photon_transport import TransportSetup, follow_photons
from .voxel_grid import Voxels, voxelise_scene

# Side length of a detector cell in which absorbed energy is summed, in mm.
_CELL_MM = 8.0
# Standard deviation of the Gaussian filter that smooths the scatter map, in cells.
_SMOOTH_CELLS = 1.0
# Default voxel size, in mm.
_VOXEL_MM = 2.0
# Number of voxels above which the default voxel size is increased.
_MAX_VOXELS = 10e6
# Number of photon batches, which is independent of the number of workers. The spread between batches gives the
# statistical error.
_BATCHES = 32
# Spawn key of the random stream for photons, combined with the seed; shape, pose and noise have other spawn keys.
_SEED_STREAM = 4
# Thickness of muscle for sampling photon energies, in mm; assumed. Half of the energies are sampled from the signal
# spectrum of the open beam, and half from the signal spectrum behind this thickness.
_MUSCLE_THICKNESS_MM = 60.0


@dataclass(frozen=True, kw_only=True)
class PhotonTally:
    """Energy that the simulated photons deposit.

    Attributes
    ----------
    primary_kev, scatter_kev : (batches, rows, cols) float64 array
        Energy of unscattered and of scattered photons that the detector absorbs per cell, in keV for the mAs of the
        protocol. The mean over batches is the estimate, and the spread between batches determines the statistical
        error.
    pixels : (rows, cols) float64 array
        Number of pixels per cell; cells at the lower and right edge may have fewer.
    pixels_per_cell : int
        Number of pixels along the side of a cell.
    energy_kev : (4,) float64 array
        Energies emitted, absorbed in the scene, incident on the detector, and missing the detector, in keV.
    """

    primary_kev: Array
    scatter_kev: Array
    pixels: Array
    pixels_per_cell: int
    energy_kev: Array


def compute_monte_carlo_scatter_kev(
    scene: Scene, technique: Technique, *, photons: int = 20_000_000, seed: int = 0, workers: int = 2
) -> tuple[NDArray[np.float32], float]:
    """Compute the scatter signal and its statistical error by Monte Carlo simulation.

    The irradiated area is the collimated field on the detector (see `xray.collimator`), with sharp edges.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials.
    technique : Technique
        Resolved protocol.
    photons : int, default 20_000_000
        Number of photons aimed at the irradiated part of the scene. The statistical error is inversely proportional to
        the square root of the number of photons.
    seed : int, default 0
        Seed of the random numbers. The same seed yields identical results for any number of workers.
    workers : int, default 2
        Number of threads, from 1 to 256.

    Returns
    -------
    scatter_kev : (rows, cols) float32 array
        Mean energy absorbed from scattered photons, in keV per pixel, smoothed over 8 mm.
    error : float
        Statistical error of the scatter: root mean square over the detector, relative to the mean scatter.

    Raises
    ------
    InputError
        If the scene cannot be traced, a material is unknown, or a number is out of range.
    """
    counts = simulate_photons(scene, technique, photons=photons, seed=seed, workers=workers)
    # Each batch is smoothed separately, so that the spread between batches gives the error of the smoothed map.
    maps = np.array([_smooth_cells(batch) for batch in counts.scatter_kev]) / _smooth_cells(counts.pixels)
    mean, error = maps.mean(axis=0), maps.std(axis=0, ddof=1) / np.sqrt(len(maps))
    relative = float(np.sqrt(np.mean(error**2)) / mean.mean()) if mean.any() else 0.0
    return upsample_linear(mean, counts.pixels_per_cell, (technique.view.rows, technique.view.cols)), relative


def simulate_photons(
    scene: Scene,
    technique: Technique,
    *,
    photons: int,
    seed: int = 0,
    workers: int = 2,
    cell_mm: float = _CELL_MM,
    voxel_mm: float | None = None,
) -> PhotonTally:
    """Transport photons from the source of a technique through a scene to its detector.

    Source, scene and detector are in vacuum. The source is a point without heel effect. The density of every material
    is constant.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials.
    technique : Technique
        Resolved protocol.
    photons : int
        Number of photons, from 32 to 10**12.
    seed : int, default 0
        Seed of the random numbers.
    workers : int, default 2
        Number of threads, from 1 to 256.
    cell_mm : float, default 8
        Side length of a cell in mm, which is rounded to whole pixels.
    voxel_mm : float, optional
        Voxel size, in mm. The default is 2 mm; it is larger for scenes that would need more than 10 million voxels.

    Returns
    -------
    PhotonTally
        Absorbed energy in each cell and photon batch, and energy balance.

    Raises
    ------
    InputError
        If the scene cannot be traced, a material is unknown, or a number is out of range.
    """
    require_integer("photons", photons, _BATCHES, 10**12, "")
    require_seed(seed)
    require_workers(workers)
    view, step = technique.view, max(1, round(cell_mm / technique.view.pixel_mm))
    voxels = _voxelise_before_detector(scene, view, voxel_mm)
    where = _make_transport_setup(voxels, technique, step * view.pixel_mm)
    what = make_interaction_tables(
        tuple(technique.material(name) for name in voxels.names), float(where.energies.max())
    )
    shape = (-(-view.rows // step), -(-view.cols // step))
    counts, energy = np.zeros((_BATCHES, 2, *shape)), np.zeros((_BATCHES, 4))
    each = -(-photons // _BATCHES)

    def batch(number: int) -> None:
        stream = np.random.SeedSequence(seed, spawn_key=(_SEED_STREAM, number)).generate_state(4, np.uint64)
        follow_photons(each, stream.astype(np.uint64), where, what, counts[number], energy[number])

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(batch, range(_BATCHES)))
    # Each photon represents an equal fraction of the target area.
    area = float(np.diff(where.window[:2])[0] * np.diff(where.window[2:])[0]) / each
    inside = [np.diff(np.append(np.arange(0, n, step), n)) for n in (view.rows, view.cols)]
    return PhotonTally(
        primary_kev=counts[:, 0] * area,
        scatter_kev=counts[:, 1] * area,
        pixels=np.outer(*inside).astype(np.float64),
        pixels_per_cell=step,
        energy_kev=energy.mean(axis=0) * area,
    )


def _voxelise_before_detector(scene: Scene, view: View, voxel_mm: float | None) -> Voxels:
    """Voxelise the part of a scene between source and detector."""
    bounds = scene.bounds_mm.copy()
    bounds[:, 1] = np.clip(bounds[:, 1], view.source_mm[1], view.centre_mm[1])
    # A scene that is not between source and detector is reduced to a thin sheet.
    bounds[0, 1] = min(bounds[0, 1], bounds[1, 1] - 0.001)
    size = voxel_mm or max(_VOXEL_MM, float(np.prod(np.ptp(bounds, axis=0)) / _MAX_VOXELS) ** (1 / 3))
    return voxelise_scene(scene, bounds, voxel_mm=size)


def _make_transport_setup(voxels: Voxels, technique: Technique, cell_mm: float) -> TransportSetup:
    """Collect source, detector, energies and voxels for the photon transport."""
    view, beam = technique.view, compute_beam(technique)
    kept = beam.energies_kev >= CUT_OFF_KEV
    energies, photons, signal = (v[kept] for v in (beam.energies_kev, beam.photons_per_mm2, beam.signal_kev))
    left = (photons if photons.any() else np.ones_like(photons)) * signal
    passed = left * np.exp(-attenuation_per_mm(technique.material("muscle"), energies) * _MUSCLE_THICKNESS_MM)
    # Energies are sampled from the mean of the two distributions, so that photon weights stay limited behind both thick
    # and thin tissue.
    chance = left / left.sum() / 2 + passed / passed.sum() / 2
    chosen = np.cumsum(chance)
    chosen[-1] = 1.0
    field = _detector_bounds_mm(view)
    return TransportSetup(
        source=np.array(view.source_mm),
        detector_y_mm=view.centre_mm[1],
        window=_aim_bounds_mm(voxels, view, _irradiated_bounds_mm(technique, field)),
        field=np.array([*field, cell_mm]),
        energies=energies,
        energy_cdf=chosen,
        weights=photons / chance,
        material=voxels.index,
        origin=voxels.origin_mm,
        size=voxels.size_mm,
        **_scintillator_tables(technique.detector, float(energies.max())),
    )


def _scintillator_tables(detector: Detector, max_kev: float) -> dict[str, Array]:
    """Tabulate optical depths and the deposited fraction of a detector, keyed by field of `TransportSetup`.

    The deposited fraction is that of normal incidence.
    """
    energies = table_energies_kev(max_kev)
    scintillator, cover = compute_optical_depths(detector, energies)
    response = load_scintillator_response(detector)
    return {
        # The optical depth of an opaque layer is limited to 28, which changes the absorption by only 1e-12.
        "scintillator_depth": np.minimum(scintillator, 28.0),
        "cover_depth": cover,
        "deposited_fraction": np.interp(energies, response.energies_kev, response.mean),
    }


def _detector_bounds_mm(view: View) -> Array:
    """Compute the detector bounds (4,) in mm, up to the outer pixel edges: x min, x max, z min, z max."""
    half_x, half_z = view.cols * view.pixel_mm / 2, view.rows * view.pixel_mm / 2
    x, _, z = view.centre_mm
    return np.array([x - half_x, x + half_x, z - half_z, z + half_z])


def _irradiated_bounds_mm(technique: Technique, field: Array) -> Array:
    """Compute the bounds (4,) of the irradiated detector area in mm, for sharp collimator edges."""
    x, _, z = technique.view.centre_mm
    half_x, half_z = field_half_size_mm(technique)
    lit = np.array([x - half_x, x + half_x, z - half_z, z + half_z])
    return np.where([1, 0, 1, 0], np.maximum(lit, field), np.minimum(lit, field))


def _aim_bounds_mm(voxels: Voxels, view: View, field: Array) -> Array:
    """Compute the bounds (4,) of the part of the field that is behind the voxel grid, in mm."""
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


def _smooth_cells(cells: Array) -> Array:
    """Smooth a map of detector cells (rows, cols), with zeros outside the detector."""
    return np.asarray(ndimage.gaussian_filter(cells, _SMOOTH_CELLS, mode="constant"))
