"""The stages of a radiograph in their order: what asks for each, and what it does to the latent image.

A stage reads the chain, which is resolved once. One that the protocol does not ask for is not run, and costs nothing.
Anatomy and rays come before all of them, since paths may be given.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .core.checks import Array
from .core.timer import Timer
from .detector import blur
from .detector.marker import lead_letter
from .detector.noise import Map, quantum_noise
from .detector.panel import readout
from .geometry.scene import Scene
from .geometry.view import View, spot_views
from .model.protocol import Protocol
from .raycast import trace_strips
from .scatter.grid import grid_of, scatter_passing, transmit_through_grid
from .scatter.kernel import exit_gaps_mm, middle_gap_mm, scatter_kev
from .scatter.monte_carlo import scatter_monte_carlo
from .xray.primary import Signal, primary_of, primary_through
from .xray.spectrum import beam_of
from .xray.technique import Technique

# Stream below a radiograph's seed; shape and pose are drawn with the knee, before it.
_NOISE = 3
_POINTS = 3  # a side of the focal spot that rays come from where it is sampled


@dataclass(frozen=True, kw_only=True)
class Chain:
    """What all stages read.

    technique  the protocol, resolved
    engine     that casts rays from points of the focal spot
    seed       of this exposure; quantum and readout noise own separate streams below it
    keep       maps to hold
    workers    threads
    """

    technique: Technique
    engine: str = "embree"
    seed: int = 0
    keep: frozenset[str] = frozenset()
    workers: int = 2

    def stream(self, number: int) -> np.random.SeedSequence:
        """Of noise: 0 quanta, 1 readout."""
        return np.random.SeedSequence(self.seed, spawn_key=(_NOISE, number))


@dataclass(kw_only=True)
class LatentImage:
    """What the stages hand on; maps are (rows, cols) float32, keV a pixel.

    path_mm        material -> (rows, cols)  path lengths, as arrays or in strips; none once no stage reads them
    scene          that they are of; None for an open beam
    gap_mm         from the object's exit to the detector plane; of the scene, where it is asked for, if None
    primary        signal of the straight rays
    behind_grid    of the same rays, where the protocol has a grid
    scatter        of the others
    signal         both, without noise
    noisy          with quantum noise
    kept           what is held
    pixels         (rows, cols) uint16
    """

    path_mm: Mapping[str, Any]
    scene: Scene | None = None
    gaps_mm: Array | float | None = None
    primary: Signal | None = None
    behind_grid: Signal | None = None
    scatter: Map | None = None
    signal: Map | None = None
    noisy: Map | None = None
    kept: dict[str, Any] = field(default_factory=dict)
    pixels: NDArray[np.uint16] | None = None
    frequencies: blur.Frequencies | None = None

    def exit_gaps_mm(self, view: View) -> Array | float:
        """From where rays leave the object to the detector plane: for the kernel of scatter, and for a grid."""
        if self.gaps_mm is None:
            self.gaps_mm = 0.0 if self.scene is None else exit_gaps_mm(self.scene, view)
        return self.gaps_mm

    @property
    def straight(self) -> Signal:
        """The primary, which a stage before has made."""
        assert self.primary is not None
        return self.primary

    @property
    def mean(self) -> Map:
        """Primary and scatter, added up when they are first asked for together."""
        if self.signal is None:
            primary = self.straight.kev
            self.signal = primary if self.scatter is None else primary + self.scatter
        return self.signal

    def transform(self, workers: int) -> blur.Frequencies:
        """The signal in frequency, which focal spot and panel both multiply."""
        if self.frequencies is None:
            self.frequencies = blur.forward(self.mean, workers)
        return self.frequencies


@dataclass(frozen=True)
class Stage:
    """One step of the chain.

    name    its time is put down under
    wanted  whether a protocol asks for it
    run     changes the image
    reads   maps that are let go before later stages, unless these read them: "paths", and primary and scatter apart
            with them; "photons", of the primary what a photon brings
    """

    name: str
    wanted: Callable[[Protocol], bool]
    run: Callable[[LatentImage, Chain], None]
    reads: Literal["paths", "photons"] | None = None


def load_spectrum(image: LatentImage, chain: Chain) -> None:
    """SpekPy's spectrum, computed where it is new, so that the next stage's time is its own."""
    beam_of(chain.technique)


def attenuate(image: LatentImage, chain: Chain) -> None:
    """Primary by Beer and Lambert, along the rays from the middle of the focal spot."""
    technique = chain.technique
    if technique.protocol.grid_ratio > 0:
        image.primary, image.behind_grid = _about_grid(image, chain)
    else:
        image.primary = primary_of(image.path_mm, technique, chain.workers)


def sample_focal_spot(image: LatentImage, chain: Chain) -> None:
    """Primary along rays from points of the focal spot, right at every depth."""
    assert image.scene is not None
    image.primary = sampled_primary(image.scene, chain.technique, chain.engine, chain.workers)


def scatter_by_kernel(image: LatentImage, chain: Chain) -> None:
    """Scatter by the kernel fitted to the Monte Carlo."""
    image.scatter = scatter_kev(
        image.straight.kev, image.path_mm, image.exit_gaps_mm(chain.technique.view), chain.technique, chain.workers
    )


def scatter_by_photons(image: LatentImage, chain: Chain) -> None:
    """Scatter by photons followed through the scene's voxels, and how sure it is."""
    assert image.scene is not None
    image.scatter, image.kept["scatter_error"] = scatter_monte_carlo(
        image.scene,
        chain.technique,
        photons=chain.technique.protocol.scatter_photons,
        seed=chain.seed,
        workers=chain.workers,
    )


def pass_grid(image: LatentImage, chain: Chain) -> None:
    """What of primary and scatter passes a grid; the primary by its energies in each pixel."""
    technique, primary, grid = chain.technique, image.straight, grid_of(chain.technique.protocol)
    if image.behind_grid is not None:
        image.primary, image.behind_grid = image.behind_grid, None
    else:
        # Rays from the middle of the spot say what share passes of those from all over it.
        before, after = _about_grid(image, chain)
        passed = np.divide(after.kev, before.kev, out=np.zeros_like(after.kev), where=before.kev > 0)
        image.primary = Signal(primary.kev * passed, after.photon_kev)
    if image.scatter is not None:
        gap_mm = middle_gap_mm(image.exit_gaps_mm(technique.view))
        image.scatter = image.scatter * np.float32(
            scatter_passing(grid, beam_of(technique), gap_mm, technique.material("muscle"))
        )


def _about_grid(image: LatentImage, chain: Chain) -> tuple[Signal, Signal]:
    """Primary before and behind the grid, along the rays from the middle of the focal spot."""
    through = partial(transmit_through_grid, grid_of(chain.technique.protocol))
    return primary_through(image.path_mm, chain.technique, through, chain.workers)


def blur_focal_spot(image: LatentImage, chain: Chain) -> None:
    """Blur of the whole image, as of an edge in the joint plane."""
    protocol, shape, values = chain.technique.protocol, image.mean.shape, image.transform(chain.workers)
    blur.by_focal_spot(values, shape, blur.shadow_px(protocol.focal_spot_mm, chain.technique.view))
    signal = blur.backward(values, shape, chain.workers)
    image.signal = np.maximum(signal, 0, out=signal)


def lay_marker(image: LatentImage, chain: Chain) -> None:
    """A letter of lead on the detector's cover, near enough to cast a sharp shadow."""
    image.signal = image.mean * lead_letter(chain.technique)
    image.frequencies = None


def draw_quanta(image: LatentImage, chain: Chain) -> None:
    """The chance of how many photons are absorbed."""
    photon_kev, swank = image.straight.photon_kev, chain.technique.detector.swank
    image.noisy = quantum_noise(image.mean, photon_kev, swank, chain.stream(0), chain.workers)


def blur_panel(image: LatentImage, chain: Chain) -> None:
    """The panel's blur: of the signal by its MTF, of quantum noise by a transfer of its own."""
    panel = (chain.technique.protocol.pixel_mm, chain.technique.detector)
    signal, noise, values = image.mean, image.noisy, image.transform(chain.workers)
    blur.by_panel(values, signal.shape, *panel)
    if "noise_free" in chain.keep or noise is None:
        image.signal = blur.backward(values, signal.shape, chain.workers)
    if noise is not None:
        noise -= signal
        coloured = blur.forward(noise, chain.workers)
        # What is no longer read goes before more is made.
        image.noisy = None
        del noise
        blur.by_panel(coloured, signal.shape, *panel, part="ntf")
        coloured += values
        image.frequencies = None
        del values
        image.noisy = blur.backward(coloured, signal.shape, chain.workers)


def read_out(image: LatentImage, chain: Chain) -> None:
    """Gain, readout noise, offset, 16 bit."""
    if "noise_free" in chain.keep:
        image.kept["noise_free"] = readout(image.mean, chain.technique, None)
    values, seed = (image.mean, None) if image.noisy is None else (image.noisy, chain.stream(1))
    image.pixels = readout(values, chain.technique, seed, chain.workers)


STAGES = (
    Stage("spectrum", lambda protocol: protocol.focal_spot != "sampled", load_spectrum),
    Stage("attenuation", lambda protocol: protocol.focal_spot != "sampled", attenuate, "paths"),
    Stage("focal spot", lambda protocol: protocol.focal_spot == "sampled", sample_focal_spot),
    Stage("scatter", lambda protocol: protocol.scatter == "kernel", scatter_by_kernel, "paths"),
    Stage("scatter", lambda protocol: protocol.scatter == "monte_carlo", scatter_by_photons, "paths"),
    Stage("grid", lambda protocol: protocol.grid_ratio > 0, pass_grid, "paths"),
    Stage("focal spot", lambda protocol: protocol.focal_spot_mm > 0 and protocol.focal_spot == "blur", blur_focal_spot),
    Stage("marker", lambda protocol: protocol.marker != "none", lay_marker),
    Stage("quantum noise", lambda protocol: protocol.noise == "quantum", draw_quanta, "photons"),
    Stage("detector blur", lambda protocol: protocol.detector_blur != "none", blur_panel),
    Stage("readout", lambda protocol: True, read_out),
)


def stages_of(protocol: Protocol) -> list[Stage]:
    """The stages that a protocol asks for, in their order."""
    return [stage for stage in STAGES if stage.wanted(protocol)]


def expose(image: LatentImage, chain: Chain) -> dict[str, float]:
    """Run the stages that the chain's protocol asks for; returns stage -> seconds. The image holds what is kept alone.

    raises  InputError as the stages
    """
    clock, stages = Timer(), stages_of(chain.technique.protocol)
    for place, stage in enumerate(stages, 1):
        stage.run(image, chain)
        clock.lap(stage.name)
        _let_go(image, {later.reads for later in stages[place:]}, chain.keep)
    return clock.seconds


def _let_go(image: LatentImage, read_later: set[str | None], keep: frozenset[str]) -> None:
    """Drop maps that no later stage reads: of a large detector each is a quarter of a gigabyte."""
    if "paths" in read_later or image.primary is None:
        return
    image.path_mm = {}
    for name, held in (("primary", image.primary.kev), ("scatter", image.scatter)):
        if name in keep and held is not None:
            image.kept.setdefault(name, held)
    signal = image.mean
    # Quantum noise reads of the primary what a photon brings; the sum stands in for the energy, which none reads again.
    image.primary = Signal(signal, image.primary.photon_kev) if "photons" in read_later else None
    image.scatter = None


def sampled_primary(scene: Scene, technique: Technique, engine: str, workers: int, points: int = _POINTS) -> Signal:
    """Primary signal as the mean over rays from points of the focal spot, so many a side (`geometry.spot_views`)."""
    protocol, shape = technique.protocol, (technique.view.rows, technique.view.cols)
    kev, square = (np.zeros(shape, np.float32) for _ in range(2))
    for view, share in spot_views(protocol, points):
        path_mm, _ = trace_strips(scene, view, engine=engine, texture=protocol.texture != "none", workers=workers)
        one = primary_of(path_mm, technique, workers, view)
        kev += np.float32(share) * one.kev
        square += np.float32(share) * one.kev * one.photon_kev
    return Signal(kev, np.divide(square, kev, out=np.zeros_like(kev), where=kev > 0))
