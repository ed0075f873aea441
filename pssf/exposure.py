"""detector.expose   path lengths, protocol, chance  -> pixels, and what was asked to be kept
detector.present  pixels                          -> a view for eyes

materials  attenuation        spectrum  the beam and the detector's response        primary  Beer-Lambert
scatter    kernel scatter     grid      against scatter                             blur     focal spot, panel
panel      noise, 16 bit      monte_carlo  photons one by one, through voxels    rendering  for eyes
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .core.timer import Clock
from .detector import blur
from .detector.blur import Map
from .detector.panel import quantum_noise, readout
from .detector.rendering import present
from .geometry.view import View, view_of
from .model.protocol import Protocol
from .scatter.grid import Grid, behind, grid_of, scatter_passing
from .scatter.kernel import scatter_kev
from .xray.materials import check_materials
from .xray.primary import Signal, transmit
from .xray.spectrum import beam_for, beam_of, heel_factor

__all__ = ["Signal", "check_materials", "expose", "present", "primary_of"]


def expose(
    path_mm: Mapping[str, NDArray[np.float32]],
    protocol: Protocol,
    *,
    gap_mm: float,
    seed: np.random.SeedSequence,
    primary: Signal | None = None,
    scatter: Map | None = None,
    keep: Collection[str] = (),
    workers: int = 2,
) -> tuple[NDArray[np.uint16], dict[str, Any], dict[str, float]]:
    """One exposure through known path lengths.

    path_mm  material -> (rows, cols) float32, mm
    gap_mm   from the object's exit to the detector plane
    seed     of this exposure's noise; quantum and readout noise own separate streams
    primary  what `primary_of` gives for these path lengths, or a mean of it over the focal spot
    scatter  (rows, cols)  keV a pixel, of `monte_carlo.scatter_monte_carlo`; the kernel makes its own
    keep     any of "primary", "scatter" (keV a pixel, behind the grid, before blur), "noise_free" (no noise)
    returns  pixels (rows, cols) uint16; kept maps; seconds a stage
    """
    clock, kept = Clock(), dict[str, Any]()
    if primary is None:
        beam_of(protocol)
        clock.lap("spectrum")
        primary = primary_of(path_mm, protocol, workers)
        clock.lap("attenuation")
    kev = primary.kev
    if protocol.scatter == "kernel":
        scatter = scatter_kev(kev, path_mm, gap_mm, protocol)
        clock.lap("scatter")
    if protocol.grid_ratio > 0:
        before = primary_of(path_mm, protocol, workers) if protocol.focal_spot == "sampled" else primary
        primary, scatter = _behind_grid(primary, before, scatter, path_mm, protocol, gap_mm, workers)
        kev = primary.kev
        clock.lap("grid")
    kept["primary"] = kev
    if scatter is not None:
        kept["scatter"] = scatter
        kev = kev + scatter
    noisy = protocol.noise == "quantum"
    streams = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in (0, 1)]
    kev, quiet = _seen(kev, primary.photon_kev, protocol, streams[0], keep, clock, workers)
    if quiet is not None:
        kept["noise_free"] = readout(quiet, protocol, None)
    pixels = readout(kev, protocol, streams[1] if noisy else None, workers)
    clock.lap("readout")
    return pixels, {name: kept[name] for name in keep if name in kept}, clock.seconds


def _seen(
    kev: Map,
    photon_kev: Map,
    protocol: Protocol,
    seed: np.random.SeedSequence,
    keep: Collection[str],
    clock: Clock,
    workers: int,
) -> tuple[Map, Map | None]:
    """Energy that the panel reads, keV a pixel: blurred by focal spot and panel, with its quantum noise.

    returns  that; and, where it is to be kept, the same without noise
    """
    both = "noise_free" in keep
    panel, shape = (protocol.pixel_mm, protocol.detector), kev.shape
    by_spot = protocol.focal_spot_mm > 0 and protocol.focal_spot == "blur"
    by_panel = protocol.detector_blur != "none"
    values = blur.forward(kev, workers) if by_spot or by_panel else None
    if by_spot and values is not None:
        blur.by_focal_spot(values, shape, blur.shadow_px(protocol.focal_spot_mm, view_of(protocol)))
        kev = np.maximum(blur.backward(values, shape, workers), 0)
        clock.lap("focal spot")
    quiet, noise = kev, None
    if protocol.noise == "quantum":
        noise = quantum_noise(kev, photon_kev, seed, workers, protocol.detector)
        clock.lap("quantum noise")
    if by_panel and values is not None:
        blur.by_panel(values, shape, *panel)
        quiet = blur.backward(values, shape, workers) if both or noise is None else kev
        if noise is not None:
            noise -= kev
            coloured = blur.forward(noise, workers)
            blur.by_panel(coloured, shape, *panel, part="ntf")
            coloured += values
            noise = blur.backward(coloured, shape, workers)
        clock.lap("detector blur")
    return (quiet if noise is None else noise), (quiet if both else None)


def needs_gap(protocol: Protocol) -> bool:
    """Whether `expose` asks how far the patient is from the panel: for the kernel of scatter, and for a grid."""
    return protocol.scatter == "kernel" or protocol.grid_ratio > 0


def _behind_grid(
    primary: Signal,
    before: Signal,
    scatter: Map | None,
    path_mm: Mapping[str, NDArray[np.float32]],
    protocol: Protocol,
    gap_mm: float,
    workers: int,
) -> tuple[Signal, Map | None]:
    """Primary and scatter that pass the protocol's grid; the primary by its energies in each pixel.

    before  the primary without the grid along the paths, which `primary` is too where it is no mean over the focal spot
    """
    kind = grid_of(protocol)
    after = primary_of(path_mm, protocol, workers, grid=kind)
    share = np.divide(after.kev, before.kev, out=np.zeros_like(after.kev), where=before.kev > 0)
    if scatter is not None:
        scatter = scatter * np.float32(scatter_passing(kind, beam_of(protocol), gap_mm))
    return Signal(primary.kev * share, after.photon_kev), scatter


def primary_of(
    path_mm: Mapping[str, NDArray[np.float32]],
    protocol: Protocol,
    workers: int = 2,
    view: View | None = None,
    grid: Grid | None = None,
) -> Signal:
    """Primary signal behind path lengths, heel effect included.

    view  of a source that is not in the middle of the focal spot; that of the protocol if None
    grid  that it passes, if any
    """
    beam = beam_for(protocol, {name: float(lengths.max()) for name, lengths in path_mm.items()})
    if grid is not None:
        beam = behind(grid, beam)
    signal = transmit(path_mm, beam, view or view_of(protocol), workers)
    if protocol.heel != "none":
        signal.kev[:] *= heel_factor(protocol)[:, None].astype(np.float32)
    return signal
