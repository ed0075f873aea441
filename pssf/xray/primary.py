"""Beer-Lambert: what passes the scene and is absorbed in each pixel, over all energies at once."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import kernel
from ..geometry.view import View
from .collimator import field_of_view, is_collimated
from .materials import attenuation_per_mm
from .spectrum import Beam, beam_for, heel_factor
from .technique import Technique

_BAND_ROWS = 128
# Pixels of a row whose exponents stay in the fastest cache, and are added up side by side.
_RUN_COLS = 256


class _Nodes(NamedTuple):
    """Attenuation (materials, nodes), 1/mm, and what each node brings to both sums (beams, nodes) in the open."""

    mu: Array
    signal: Array
    square: Array


class _Rays(NamedTuple):
    """Source and centre of pixel (0, 0), (3,) mm, and the pitch."""

    source: Array
    corner: Array
    pixel_mm: float


@dataclass(frozen=True)
class Signal:
    """Energy absorbed a pixel, before noise.

    kev         (rows, cols) float32  mean
    photon_kev  (rows, cols) float32  mean square over mean energy of an absorbed photon: variance over mean of `kev`
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
    """Primary signal of every pixel.

    path_mm    material -> (rows, cols)  path lengths; a material that is absent attenuates nothing
    technique  whose tissues the materials are
    workers    threads; the result does not depend on them
    view       of a source that is not in the middle of the focal spot; that of the technique if None
    """
    return _transmit_beams(path_mm, (beam,), technique, workers, view)[0]


def primary_of(
    path_mm: Mapping[str, Any],
    technique: Technique,
    workers: int = 2,
    view: View | None = None,
) -> Signal:
    """Primary signal behind path lengths (rows, cols), mm, heel effect and collimator included.

    view  of a source that is not in the middle of the focal spot; that of the technique if None
    """
    return _primaries(path_mm, (_beam_behind(path_mm, technique),), technique, workers, view)[0]


def primary_through(
    path_mm: Mapping[str, Any],
    technique: Technique,
    through: Callable[[Beam], Beam],
    workers: int = 2,
) -> tuple[Signal, Signal]:
    """Primary signal before and behind what the beam passes after the limb, such as a grid.

    Both sums are over the same exponentials, which are nearly all of the time.
    """
    beam = _beam_behind(path_mm, technique)
    before, behind = _primaries(path_mm, (beam, through(beam)), technique, workers)
    return before, behind


def _beam_behind(path_mm: Mapping[str, Any], technique: Technique) -> Beam:
    """The beam by energies enough for path lengths (rows, cols), mm."""
    return beam_for(technique, {name: float(lengths.max()) for name, lengths in path_mm.items()})


def _primaries(
    path_mm: Mapping[str, Any], beams: Sequence[Beam], technique: Technique, workers: int, view: View | None = None
) -> list[Signal]:
    """Signals by beams of the same energies, heel effect and collimator included."""
    signals = _transmit_beams(path_mm, beams, technique, workers, view)
    for signal in signals:
        if technique.protocol.heel != "none":
            signal.kev[:] *= heel_factor(technique)[:, None].astype(np.float32)
        if is_collimated(technique.protocol):
            signal.kev[:] *= field_of_view(technique)
    return signals


def _transmit_beams(
    path_mm: Mapping[str, Any], beams: Sequence[Beam], technique: Technique, workers: int, view: View | None
) -> list[Signal]:
    view, energies_kev = view or technique.view, beams[0].energies_kev
    mu = np.array([attenuation_per_mm(technique.material(name), energies_kev) for name in path_mm])
    mu = mu.reshape(-1, len(energies_kev))
    kev, photon_kev = (np.empty((len(beams), view.rows, view.cols), np.float32) for _ in range(2))
    brought = [[beam.photons_per_mm2 * each for each in (beam.signal_kev, beam.square_kev2)] for beam in beams]
    nodes = _Nodes(mu, *(np.array(of_all) for of_all in zip(*brought, strict=True)))
    rays = _Rays(np.asarray(view.source_mm), np.asarray(view.corner_mm), view.pixel_mm)

    def band(start: int) -> None:
        stop = min(start + _BAND_ROWS, view.rows)
        # Copied band by band: all maps of a large detector in one piece would double the memory.
        stack = np.empty((len(path_mm), stop - start, view.cols), np.float32)
        for part, lengths in zip(stack, path_mm.values(), strict=True):
            part[:] = lengths[start:stop]
        _transmit(stack, nodes, rays, start, kev[:, start:stop], photon_kev[:, start:stop])

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(band, range(0, view.rows, _BAND_ROWS)))
    return [Signal(*both) for both in zip(kev, photon_kev, strict=True)]


@kernel(fastmath={"contract"})
def _transmit(
    stack: NDArray[np.float32],
    nodes: _Nodes,
    rays: _Rays,
    start: int,
    kev: NDArray[np.float32],
    photon_kev: NDArray[np.float32],
) -> None:
    """Fill the rows (beams, rows, cols) of a band, whose first is `start`."""
    mu, (materials, count), beams = nodes.mu, nodes.mu.shape, len(nodes.signal)
    passed, open_beams = np.empty(count), np.zeros((beams, 2))
    for beam in range(beams):
        for k in range(count):
            open_beams[beam, 0] += nodes.signal[beam, k]
            open_beams[beam, 1] += nodes.square[beam, k]
    depth = rays.corner[1] - rays.source[1]
    exponents, areas = np.empty((count, _RUN_COLS)), np.empty(_RUN_COLS)
    for row in range(kev.shape[1]):
        dz = rays.corner[2] - (start + row) * rays.pixel_mm - rays.source[2]
        for left in range(0, kev.shape[2], _RUN_COLS):
            width = min(_RUN_COLS, kev.shape[2] - left)
            exponents[:] = 0.0
            for m in range(materials):
                lengths = stack[m, row, left : left + width]
                for k in range(count):
                    for n in range(width):
                        exponents[k, n] -= mu[m, k] * lengths[n]
            for n in range(width):
                dx = rays.corner[0] + (left + n) * rays.pixel_mm - rays.source[0]
                distance2 = dx * dx + depth * depth + dz * dz
                # Inverse square from 1 m, and the pixel seen at a slant.
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
                            second += nodes.square[beam, k] * passed[k]
                    kev[beam, row, left + n] = first * areas[n]
                    photon_kev[beam, row, left + n] = second / first if first > 0.0 else 0.0
