"""Primary signal of every pixel by the Beer-Lambert law, summed over all energies."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel
from ..geometry.view import View
from .collimator import compute_collimator_transmission, is_collimated
from .materials import attenuation_per_mm
from .resolved_technique import Technique
from .spectrum import Beam, compute_reduced_beam, heel_factor

# Number of detector rows per band; each band is one task of the thread pool.
_BAND_ROWS = 128
# Number of pixels in a row that are computed together, so that their exponents fit into the first-level cache.
_BLOCK_COLS = 256


class _EnergyNodes(NamedTuple):
    """Attenuation at each energy, and contribution of each energy to the open-beam signal.

    `mu` is (materials, nodes), in 1/mm. `signal` and `square_signal` are (beams, nodes): first and second moment of the
    absorbed energy.
    """

    mu: Array
    signal: Array
    square_signal: Array


class _RayGeometry(NamedTuple):
    """Source and centre of pixel (0, 0), (3,) in mm, and the pixel size in mm."""

    source: Array
    corner: Array
    pixel_mm: float


@dataclass(frozen=True)
class Signal:
    """Energy absorbed per pixel, before noise.

    Attributes
    ----------
    kev : (rows, cols) float32 array
        Mean energy absorbed, in keV per pixel.
    photon_kev : (rows, cols) float32 array
        Mean squared energy divided by mean energy of the absorbed photons, in keV. For Poisson statistics, this ratio
        equals the variance of the absorbed energy divided by its mean.
    """

    kev: NDArray[np.float32]
    photon_kev: NDArray[np.float32]


def transmit(
    path_mm: Mapping[str, Any],
    beam: Beam,
    technique: Technique,
    workers: int = 2,
    view: View | None = None,
) -> Signal:
    """Compute the primary signal of every pixel, excluding the effects of heel and collimator.

    Parameters
    ----------
    path_mm : mapping of str to (rows, cols) array
        Path length per material, in mm. A missing material does not attenuate.
    beam : Beam
        Energies, photons and detector response.
    technique : Technique
        Resolved protocol, whose tissues define the materials.
    workers : int, default 2
        Number of threads; it does not change the result.
    view : View, optional
        Source and detector positions, for example with the source at another point of the focal spot. None uses the
        view of the technique.

    Returns
    -------
    Signal
        Mean absorbed energy per pixel, and its variance divided by its mean.
    """
    return _transmit_beams(path_mm, (beam,), technique, workers, view)[0]


def compute_primary(
    path_mm: Mapping[str, Any],
    technique: Technique,
    workers: int = 2,
    view: View | None = None,
) -> Signal:
    """Compute the primary signal from path lengths, including the heel effect and the collimator.

    Parameters
    ----------
    path_mm : mapping of str to (rows, cols) array
        Path length per material, in mm.
    technique : Technique
        Resolved protocol.
    workers : int, default 2
        Number of threads; it does not change the result.
    view : View, optional
        Source and detector positions, for example with the source at another point of the focal spot. None uses the
        view of the technique.

    Returns
    -------
    Signal
        Mean absorbed energy per pixel, and its variance divided by its mean.
    """
    return _compute_primaries(path_mm, (_compute_beam_behind(path_mm, technique),), technique, workers, view)[0]


def compute_bare_primary(path_mm: Mapping[str, Any], technique: Technique, workers: int, view: View) -> Signal:
    """Compute the primary signal in a view from path lengths, without heel effect and collimator.

    Parameters
    ----------
    path_mm : mapping of str to (rows, cols) array
        Path length per material, in mm.
    technique : Technique
        Resolved protocol.
    workers : int
        Number of threads; it does not change the result.
    view : View
        Source and detector, with any number of pixels.

    Returns
    -------
    Signal
        Mean absorbed energy per pixel, and its variance divided by its mean.
    """
    return transmit(path_mm, _compute_beam_behind(path_mm, technique), technique, workers, view)


def compute_primary_before_and_behind(
    path_mm: Mapping[str, Any],
    technique: Technique,
    transmit_grid: Callable[[Beam], Beam],
    workers: int = 2,
) -> tuple[Signal, Signal]:
    """Compute the primary signal in front of and behind a filter after the limb, such as an anti-scatter grid.

    Both signals use the same exponentials, whose computation takes nearly all of the run time.

    Parameters
    ----------
    path_mm : mapping of str to (rows, cols) array
        Path length per material, in mm.
    technique : Technique
        Resolved protocol.
    transmit_grid : callable
        Function that converts the beam in front of the filter to the beam behind it.
    workers : int, default 2
        Number of threads; it does not change the result.

    Returns
    -------
    before : Signal
        Signal without the filter.
    behind : Signal
        Signal behind the filter.
    """
    beam = _compute_beam_behind(path_mm, technique)
    before, behind = _compute_primaries(path_mm, (beam, transmit_grid(beam)), technique, workers)
    return before, behind


def _compute_beam_behind(path_mm: Mapping[str, Any], technique: Technique) -> Beam:
    """Compute the beam with few energies, sufficient for the maximum path length of each material."""
    return compute_reduced_beam(technique, {name: float(lengths.max()) for name, lengths in path_mm.items()})


def _compute_primaries(
    path_mm: Mapping[str, Any], beams: Sequence[Beam], technique: Technique, workers: int, view: View | None = None
) -> list[Signal]:
    """Compute the signals of beams with the same energies, including heel effect and collimator."""
    signals = _transmit_beams(path_mm, beams, technique, workers, view)
    return [apply_field_factors(signal, technique) for signal in signals]


def apply_field_factors(signal: Signal, technique: Technique) -> Signal:
    """Apply the heel effect and the collimator to a signal, in place.

    Parameters
    ----------
    signal : Signal
        Signal without these effects, for the pixels of the protocol.
    technique : Technique
        Resolved protocol.

    Returns
    -------
    Signal
        The same signal.
    """
    if technique.protocol.heel != "none":
        signal.kev[:] *= heel_factor(technique)[:, None].astype(np.float32)
    if is_collimated(technique.protocol):
        signal.kev[:] *= compute_collimator_transmission(technique)
    return signal


def _transmit_beams(
    path_mm: Mapping[str, Any], beams: Sequence[Beam], technique: Technique, workers: int, view: View | None
) -> list[Signal]:
    """Compute the signals of beams with the same energies, excluding the effects of heel and collimator."""
    view, energies_kev = view or technique.view, beams[0].energies_kev
    mu = np.array([attenuation_per_mm(technique.material(name), energies_kev) for name in path_mm])
    mu = mu.reshape(-1, len(energies_kev))
    kev, photon_kev = (np.empty((len(beams), view.rows, view.cols), np.float32) for _ in range(2))
    brought = [[beam.photons_per_mm2 * each for each in (beam.signal_kev, beam.square_kev2)] for beam in beams]
    nodes = _EnergyNodes(mu, *(np.array(of_all) for of_all in zip(*brought, strict=True)))
    rays = _RayGeometry(np.asarray(view.source_mm), np.asarray(view.first_pixel_mm), view.pixel_mm)

    def band(start: int) -> None:
        stop = min(start + _BAND_ROWS, view.rows)
        # Path length maps are copied band by band, because a copy of whole maps would double the memory of a large
        # detector.
        stack = np.empty((len(path_mm), stop - start, view.cols), np.float32)
        for part, lengths in zip(stack, path_mm.values(), strict=True):
            part[:] = lengths[start:stop]
        _transmit_band(stack, nodes, rays, start, kev[:, start:stop], photon_kev[:, start:stop])

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(band, range(0, view.rows, _BAND_ROWS)))
    return [Signal(*both) for both in zip(kev, photon_kev, strict=True)]


@kernel(fastmath={"contract"})
def _transmit_band(
    path_stack_mm: NDArray[np.float32],
    nodes: _EnergyNodes,
    rays: _RayGeometry,
    first_row: int,
    kev: NDArray[np.float32],
    photon_kev: NDArray[np.float32],
) -> None:
    """Fill `kev` and `photon_kev` (beams, rows, cols) for a band of rows that starts at `first_row`."""
    mu, (materials, count), beams = nodes.mu, nodes.mu.shape, len(nodes.signal)
    passed, open_beams = np.empty(count), np.zeros((beams, 2))
    for beam in range(beams):
        for k in range(count):
            open_beams[beam, 0] += nodes.signal[beam, k]
            open_beams[beam, 1] += nodes.square_signal[beam, k]
    depth = rays.corner[1] - rays.source[1]
    exponents, areas = np.empty((count, _BLOCK_COLS)), np.empty(_BLOCK_COLS)
    for row in range(kev.shape[1]):
        dz = rays.corner[2] - (first_row + row) * rays.pixel_mm - rays.source[2]
        for left in range(0, kev.shape[2], _BLOCK_COLS):
            width = min(_BLOCK_COLS, kev.shape[2] - left)
            exponents[:] = 0.0
            for m in range(materials):
                lengths = path_stack_mm[m, row, left : left + width]
                for k in range(count):
                    for n in range(width):
                        exponents[k, n] -= mu[m, k] * lengths[n]
            for n in range(width):
                dx = rays.corner[0] + (left + n) * rays.pixel_mm - rays.source[0]
                distance2 = dx * dx + depth * depth + dz * dz
                # Photons per pixel follow the inverse-square law, relative to 1 m, and the cosine of the angle of
                # incidence.
                areas[n] = rays.pixel_mm * rays.pixel_mm * 1e6 / distance2 * depth / np.sqrt(distance2)
            for n in range(width):
                limb = exponents[0, n] != 0.0
                if limb:
                    for k in range(count):
                        passed[k] = np.exp(exponents[k, n])
                for beam in range(beams):
                    first, second = open_beams[beam]
                    if limb:
                        first, second = 0.0, 0.0
                        for k in range(count):
                            first += nodes.signal[beam, k] * passed[k]
                            second += nodes.square_signal[beam, k] * passed[k]
                    kev[beam, row, left + n] = first * areas[n]
                    photon_kev[beam, row, left + n] = second / first if first > 0.0 else 0.0
