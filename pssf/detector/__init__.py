"""detector.expose   path lengths, protocol, chance  -> pixels, and what was asked to be kept
detector.present  pixels                          -> an 8-bit view for eyes

materials  attenuation        spectrum  the beam and the detector's response        primary  Beer-Lambert
scatter    kernel scatter     panel     blur, noise, 16 bit
"""

from collections.abc import Collection, Mapping
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import View, view_of
from ..protocol import Protocol
from .materials import check_material
from .panel import detector_blur, focal_spot_blur, present, quantum_noise, readout
from .primary import Signal, transmit
from .scatter import scatter_kev
from .spectrum import beam_for, beam_of, heel_factor

__all__ = ["Signal", "check_material", "expose", "present", "primary_of"]


def expose(
    path_mm: Mapping[str, NDArray[np.float32]],
    protocol: Protocol,
    *,
    gap_mm: float,
    seed: np.random.SeedSequence,
    primary: Signal | None = None,
    keep: Collection[str] = (),
    workers: int = 2,
) -> tuple[NDArray[np.uint16], dict[str, Any], dict[str, float]]:
    """One exposure through known path lengths.

    path_mm  material -> (rows, cols) float32, mm
    gap_mm   from the object's exit to the detector plane
    seed     of this exposure's noise; quantum and readout noise own separate streams
    primary  what `primary_of` gives for these path lengths, or a mean of it over the focal spot
    keep     any of "primary", "scatter" (keV a pixel, before blur) and "noise_free" (pixels without noise)
    returns  pixels (rows, cols) uint16; kept maps; seconds a stage
    """
    seconds, kept = dict[str, float](), dict[str, Any]()
    clock = perf_counter()

    def lap(stage: str) -> None:
        nonlocal clock
        now = perf_counter()
        seconds[stage], clock = now - clock, now

    if primary is None:
        beam_of(protocol)
        lap("spectrum")
        primary = primary_of(path_mm, protocol, workers)
        lap("attenuation")
    kept["primary"] = kev = primary.kev
    if protocol.scatter == "kernel":
        kept["scatter"] = scatter_kev(kev, path_mm, gap_mm, protocol)
        kev = kev + kept["scatter"]
        lap("scatter")
    if protocol.focal_spot_mm > 0 and protocol.focal_spot == "blur":
        kev = np.maximum(focal_spot_blur(kev, protocol.focal_spot_mm, view_of(protocol), workers), 0)
        lap("focal spot")
    blurs = protocol.detector_blur != "none"
    panel = (protocol.pixel_mm, workers, protocol.detector)
    if "noise_free" in keep:
        kept["noise_free"] = readout(detector_blur(kev, *panel) if blurs else kev, protocol, None)
    streams = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in (0, 1)]
    noisy = protocol.noise == "quantum"
    if noisy:
        kev = quantum_noise(kev, primary.photon_kev, streams[0], workers, protocol.detector)
        lap("quantum noise")
    if blurs:
        kev = detector_blur(kev, *panel)
        lap("detector blur")
    pixels = readout(kev, protocol, streams[1] if noisy else None, workers)
    lap("readout")
    return pixels, {name: kept[name] for name in keep if name in kept}, seconds


def primary_of(
    path_mm: Mapping[str, NDArray[np.float32]], protocol: Protocol, workers: int = 2, view: View | None = None
) -> Signal:
    """Primary signal behind path lengths, heel effect included.

    view  of a source that is not in the middle of the focal spot; that of the protocol if None
    """
    beam = beam_for(protocol, {name: float(lengths.max()) for name, lengths in path_mm.items()})
    signal = transmit(path_mm, beam, view or view_of(protocol), workers)
    if protocol.heel != "none":
        signal.kev[:] *= heel_factor(protocol)[:, None].astype(np.float32)
    return signal
