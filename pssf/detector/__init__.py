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

from ..geometry import view_of
from ..protocol import Protocol
from .materials import check_material
from .panel import detector_blur, focal_spot_blur, present, quantum_noise, readout
from .primary import transmit
from .scatter import scatter_kev
from .spectrum import beam_of

__all__ = ["check_material", "expose", "present"]


def expose(
    path_mm: Mapping[str, NDArray[np.float32]],
    protocol: Protocol,
    *,
    gap_mm: float,
    seed: np.random.SeedSequence,
    keep: Collection[str] = (),
    workers: int = 2,
) -> tuple[NDArray[np.uint16], dict[str, Any], dict[str, float]]:
    """One exposure through known path lengths.

    path_mm  material -> (rows, cols) float32, mm
    gap_mm   from the object's exit to the detector plane
    seed     of this exposure's noise; quantum and readout noise own separate streams
    keep     any of "primary", "scatter" (keV a pixel, before blur) and "noise_free" (pixels without noise)
    returns  pixels (rows, cols) uint16; kept maps; seconds a stage
    """
    view, seconds = view_of(protocol), dict[str, float]()
    kept: dict[str, Any] = {}
    clock = perf_counter()

    def lap(stage: str) -> None:
        nonlocal clock
        now = perf_counter()
        seconds[stage], clock = now - clock, now

    beam = beam_of(protocol)
    lap("spectrum")
    signal = transmit(path_mm, beam, view, workers)
    kev = signal.kev
    kept["primary"] = kev
    lap("attenuation")
    if protocol.scatter == "kernel":
        kept["scatter"] = scatter_kev(kev, path_mm, gap_mm, protocol)
        kev = kev + kept["scatter"]
        lap("scatter")
    if protocol.focal_spot_mm > 0:
        kev = np.maximum(focal_spot_blur(kev, protocol.focal_spot_mm, view, workers), 0)
        lap("focal spot")
    blur = (lambda image: detector_blur(image, protocol.pixel_mm, workers)) if protocol.detector_blur == "csi" else None
    if "noise_free" in keep:
        kept["noise_free"] = readout(blur(kev) if blur else kev, protocol.pixel_mm, None)
    streams = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in (0, 1)]
    noisy = protocol.noise == "quantum"
    if noisy:
        kev = quantum_noise(kev, signal.photon_kev, streams[0], workers)
        lap("quantum noise")
    if blur:
        kev = blur(kev)
        lap("detector blur")
    pixels = readout(kev, protocol.pixel_mm, streams[1] if noisy else None, workers)
    lap("readout")
    return pixels, {name: kept[name] for name in keep if name in kept}, seconds
