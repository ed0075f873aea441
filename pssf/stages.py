"""Imaging stages in order: for each stage, the protocols that need it and its effect on the latent image.

All stages use the same `StageContext`. A stage that the protocol does not need is skipped. Building the anatomy and ray
casting are not stages, because the user may also supply path lengths.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .core.checks import Array
from .core.stage_timer import Timer
from .detector import detector_blur
from .detector.panel_readout import simulate_readout
from .detector.quantum_noise import Map, sample_quantum_noise
from .detector.side_marker import compute_marker_transmission
from .geometry.scene import Scene
from .geometry.view import View
from .model.protocol import Protocol
from .scatter.antiscatter_grid import compute_scatter_transmission, make_grid, transmit_through_grid
from .scatter.monte_carlo import compute_monte_carlo_scatter_kev
from .scatter.scatter_kernel import central_air_gap_mm, compute_air_gaps_mm, compute_kernel_scatter_kev
from .xray.primary_beam import Signal, compute_primary, compute_primary_before_and_behind
from .xray.resolved_technique import Technique
from .xray.sampled_primary import (
    FOCAL_SPOT_POINTS,
    compute_sampled_primary,
    count_rays_for_thin_bodies,
    has_unresolved_edges,
)
from .xray.spectrum import compute_beam

# Spawn key of the random streams for noise, combined with the seed of a radiograph. Bone shape and pose are sampled
# earlier and have other spawn keys.
_NOISE_STREAM = 3
# Least square root of the number of rays per pixel if subpixels = 0 and the scene needs more than one.
_AUTOMATIC_SUBPIXELS = 5


@dataclass(frozen=True, kw_only=True)
class StageContext:
    """Technique and settings that all stages use.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    engine : {"embree", "scanline"}, default "embree"
        Ray casting engine for a sampled focal spot.
    seed : int, default 0
        Seed of the exposure, from which the random streams for quantum noise and readout noise are derived.
    keep : frozenset of str
        Names of the intermediate maps to store in the radiograph.
    workers : int, default 2
        Number of threads; it does not change the result.
    """

    technique: Technique
    engine: str = "embree"
    seed: int = 0
    keep: frozenset[str] = frozenset()
    workers: int = 2

    def make_noise_seed(self, number: int) -> np.random.SeedSequence:
        """Make the seed for quantum noise or readout noise.

        Parameters
        ----------
        number : int
            Number of the noise stream: 0 for quantum noise, 1 for readout noise.

        Returns
        -------
        numpy.random.SeedSequence
            Seed of the random stream.
        """
        return np.random.SeedSequence(self.seed, spawn_key=(_NOISE_STREAM, number))


@dataclass(kw_only=True)
class LatentImage:
    """State of an image between stages; maps are (rows, cols) float32 in keV per pixel.

    Parameters
    ----------
    path_mm : mapping of str to (rows, cols) array
        Path length per material, in mm, as arrays or sparse maps. The mapping is emptied after the last stage that uses
        it.
    scene : Scene, optional
        Scene in which the path lengths were computed; None if there is no scene.
    air_gaps_mm : (32, 32) float64 array or float, optional
        Distance from the exit surface of the object to the detector plane, in mm. If None, the distance is computed
        from the scene when it is first needed.
    primary : Signal, optional
        Signal of unscattered photons.
    primary_behind_grid : Signal, optional
        Signal of unscattered photons behind the anti-scatter grid, if the protocol has a grid.
    scatter : (rows, cols) float32 array, optional
        Signal of scattered photons.
    signal : (rows, cols) float32 array, optional
        Sum of primary and scatter, without noise.
    noisy : (rows, cols) float32 array, optional
        Signal with quantum noise.
    kept : dict
        Intermediate maps to store in the radiograph, keyed by name.
    pixels : (rows, cols) uint16 array, optional
        Pixel values in DN.
    frequencies : (rows, cols) complex64 array, optional
        Padded signal in the frequency domain.
    subpixels : int
        Square root of the number of rays per pixel; with 1, the primary is the signal at the centre of each pixel.
    """

    path_mm: Mapping[str, Any]
    scene: Scene | None = None
    air_gaps_mm: Array | float | None = None
    primary: Signal | None = None
    primary_behind_grid: Signal | None = None
    scatter: Map | None = None
    signal: Map | None = None
    noisy: Map | None = None
    kept: dict[str, Any] = field(default_factory=dict)
    pixels: NDArray[np.uint16] | None = None
    frequencies: detector_blur.Frequencies | None = None
    subpixels: int = 1

    def compute_air_gaps_mm(self, view: View) -> Array | float:
        """Compute the distance from the exit surface of the object to the detector plane.

        The scatter kernel and the anti-scatter grid use this distance.

        Parameters
        ----------
        view : View
            Source and detector.

        Returns
        -------
        (32, 32) float64 array or float
            Air gaps in mm, computed in the first call and then cached; 0 without a scene.
        """
        if self.air_gaps_mm is None:
            self.air_gaps_mm = 0.0 if self.scene is None else compute_air_gaps_mm(self.scene, view)
        return self.air_gaps_mm

    @property
    def computed_primary(self) -> Signal:
        """Primary signal, as computed by an earlier stage."""
        assert self.primary is not None
        return self.primary

    @property
    def expected_signal(self) -> Map:
        """Sum of primary and scatter in keV per pixel, computed at the first access and then cached."""
        if self.signal is None:
            primary = self.computed_primary.kev
            self.signal = primary if self.scatter is None else primary + self.scatter
        return self.signal

    def compute_frequencies(self, workers: int) -> detector_blur.Frequencies:
        """Transform the signal to the frequency domain, for the blur by focal spot and detector.

        Parameters
        ----------
        workers : int
            Number of threads.

        Returns
        -------
        (padded rows, padded cols / 2 + 1) complex64 array
            Fourier coefficients of the padded signal, computed in the first call and then cached.
        """
        if self.frequencies is None:
            self.frequencies = detector_blur.transform_to_frequency(self.expected_signal, workers)
        return self.frequencies


@dataclass(frozen=True)
class Stage:
    """One step of the imaging chain.

    Parameters
    ----------
    name : str
        Stage name in the reported run times.
    is_requested : callable
        Function that returns True if a protocol needs the stage.
    run : callable
        Function of a latent image and a stage context that applies the stage to the image in place.
    reads : {"paths", "photons"}, optional
        Maps that the stage uses, which must be retained until then. ``"paths"`` means path lengths, and primary and
        scatter as separate maps. ``"photons"`` means the photon energy map of the primary.
    """

    name: str
    is_requested: Callable[[Protocol], bool]
    run: Callable[[LatentImage, StageContext], None]
    reads: Literal["paths", "photons"] | None = None


def prepare_spectrum(image: LatentImage, context: StageContext) -> None:
    """Compute the tube spectrum if it is not cached, so that its run time is reported separately.

    Parameters
    ----------
    image : LatentImage
        Latent image, which this stage does not use.
    context : StageContext
        Technique and settings.
    """
    compute_beam(context.technique)


def attenuate(image: LatentImage, context: StageContext) -> None:
    """Compute the primary by the Beer-Lambert law, with rays from the centre of the focal spot.

    Parameters
    ----------
    image : LatentImage
        Image with path lengths. The primary is set, and with an anti-scatter grid also the primary behind the grid.
    context : StageContext
        Technique and settings.
    """
    technique = context.technique
    if technique.protocol.grid_ratio > 0:
        image.primary, image.primary_behind_grid = _compute_primary_at_grid(image, context)
    else:
        image.primary = compute_primary(image.path_mm, technique, context.workers)


def sample_rays(image: LatentImage, context: StageContext) -> None:
    """Compute the primary as the mean over points of the focal spot and of the pixel area.

    Several points of the focal spot give the correct blur at every depth.

    Parameters
    ----------
    image : LatentImage
        Image with a scene; the primary is set.
    context : StageContext
        Technique and settings.
    """
    assert image.scene is not None
    subpixels = context.technique.protocol.subpixels
    if subpixels == 0:
        subpixels = count_rays_for_thin_bodies(image.scene, context.technique.view)
        if subpixels > 1 or _has_unresolved_edges(image, context):
            subpixels = max(subpixels, _AUTOMATIC_SUBPIXELS)
        elif context.technique.protocol.focal_spot != "sampled":
            return
    points = FOCAL_SPOT_POINTS if context.technique.protocol.focal_spot == "sampled" else 1
    image.primary = compute_sampled_primary(
        image.scene, context.technique, context.engine, context.workers, points, subpixels
    )
    image.subpixels = subpixels
    image.primary_behind_grid = None


def _has_unresolved_edges(image: LatentImage, context: StageContext) -> bool:
    """Return whether the signal of one ray per pixel, from the centre of the focal spot, misses details."""
    # A sampled focal spot smooths the signal, so its central ray shows every edge.
    sharp = image.primary or compute_primary(image.path_mm, context.technique, context.workers)
    return has_unresolved_edges(sharp.kev)


def add_kernel_scatter(image: LatentImage, context: StageContext) -> None:
    """Compute the scatter with the kernel fitted to Monte Carlo results.

    Parameters
    ----------
    image : LatentImage
        Image with primary and path lengths; the scatter is set.
    context : StageContext
        Technique and settings.
    """
    image.scatter = compute_kernel_scatter_kev(
        image.computed_primary.kev,
        image.path_mm,
        image.compute_air_gaps_mm(context.technique.view),
        context.technique,
        context.workers,
    )


def add_monte_carlo_scatter(image: LatentImage, context: StageContext) -> None:
    """Compute the scatter and its statistical error by Monte Carlo simulation.

    Parameters
    ----------
    image : LatentImage
        Image with a scene; the scatter is set, and its statistical error is stored as ``scatter_error``.
    context : StageContext
        Technique and settings.
    """
    assert image.scene is not None
    image.scatter, image.kept["scatter_error"] = compute_monte_carlo_scatter_kev(
        image.scene,
        context.technique,
        photons=context.technique.protocol.scatter_photons,
        seed=context.seed,
        workers=context.workers,
    )


def apply_grid(image: LatentImage, context: StageContext) -> None:
    """Attenuate primary and scatter by the anti-scatter grid; the primary is attenuated by its spectrum in each pixel.

    Parameters
    ----------
    image : LatentImage
        Image with primary and path lengths; primary and scatter are modified.
    context : StageContext
        Technique and settings.
    """
    technique, primary, grid = context.technique, image.computed_primary, make_grid(context.technique.protocol)
    if image.primary_behind_grid is not None:
        image.primary, image.primary_behind_grid = image.primary_behind_grid, None
    else:
        # The grid transmission is computed for rays from the centre of the focal spot, and applied to the mean over the
        # focal spot.
        before, after = _compute_primary_at_grid(image, context)
        passed = np.divide(after.kev, before.kev, out=np.zeros_like(after.kev), where=before.kev > 0)
        image.primary = Signal(primary.kev * passed, after.photon_kev)
    if image.scatter is not None:
        gap_mm = central_air_gap_mm(image.compute_air_gaps_mm(technique.view))
        image.scatter = image.scatter * np.float32(
            compute_scatter_transmission(grid, compute_beam(technique), gap_mm, technique.material("muscle"))
        )


def _compute_primary_at_grid(image: LatentImage, context: StageContext) -> tuple[Signal, Signal]:
    """Compute the primary in front of and behind the grid, for rays from the centre of the focal spot."""
    through = partial(transmit_through_grid, make_grid(context.technique.protocol))
    return compute_primary_before_and_behind(image.path_mm, context.technique, through, context.workers)


def blur_focal_spot(image: LatentImage, context: StageContext) -> None:
    """Blur the entire image by the focal spot, with the blur width of the joint plane.

    Parameters
    ----------
    image : LatentImage
        Image with primary and scatter; the signal is modified.
    context : StageContext
        Technique and settings.
    """
    protocol, shape, values = (
        context.technique.protocol,
        image.expected_signal.shape,
        image.compute_frequencies(context.workers),
    )
    width_px = detector_blur.focal_spot_width_px(protocol.focal_spot_mm, context.technique.view)
    detector_blur.apply_focal_spot_blur(values, shape, width_px, protocol.focal_spot_shape)
    signal = detector_blur.transform_to_image(values, shape, context.workers)
    image.signal = np.maximum(signal, 0, out=signal)


def add_side_marker(image: LatentImage, context: StageContext) -> None:
    """Add the shadow of a lead letter on the detector cover, without focal-spot blur.

    Parameters
    ----------
    image : LatentImage
        Image whose signal is modified in place.
    context : StageContext
        Technique and settings.
    """
    image.signal = image.expected_signal * compute_marker_transmission(context.technique)
    image.frequencies = None


def add_quantum_noise(image: LatentImage, context: StageContext) -> None:
    """Add quantum (Poisson) noise.

    Parameters
    ----------
    image : LatentImage
        Image with a signal. The noisy signal is written to the image.
    context : StageContext
        Technique and settings.
    """
    photon_kev, swank = image.computed_primary.photon_kev, context.technique.detector.swank
    image.noisy = sample_quantum_noise(
        image.expected_signal, photon_kev, swank, context.make_noise_seed(0), context.workers
    )


def blur_panel(image: LatentImage, context: StageContext) -> None:
    """Blur the signal by the MTF of the detector, and quantum noise by the noise transfer function.

    Parameters
    ----------
    image : LatentImage
        Image whose signal is blurred in place, together with its noisy signal if present.
    context : StageContext
        Technique and settings.
    """
    panel = (context.technique.protocol.pixel_mm, context.technique.detector)
    signal, noise, values = image.expected_signal, image.noisy, image.compute_frequencies(context.workers)
    detector_blur.apply_panel_blur(values, signal.shape, *panel)
    if image.subpixels > 1:
        detector_blur.remove_pixel_aperture(values, signal.shape, image.subpixels)
    if "noise_free" in context.keep or noise is None:
        image.signal = detector_blur.transform_to_image(values, signal.shape, context.workers)
    if noise is not None:
        noise -= signal
        coloured = detector_blur.transform_to_frequency(noise, context.workers)
        # Maps that are no longer needed are released before new maps are made.
        image.noisy = None
        del noise
        detector_blur.apply_panel_blur(coloured, signal.shape, *panel, curve="ntf")
        coloured += values
        image.frequencies = None
        del values
        image.noisy = detector_blur.transform_to_image(coloured, signal.shape, context.workers)


def read_out(image: LatentImage, context: StageContext) -> None:
    """Convert the signal to pixel values: gain, readout noise, offset and 16 bits.

    Parameters
    ----------
    image : LatentImage
        Image with a signal. The pixel values are written to the image, and noise-free pixel values are stored in
        ``kept["noise_free"]`` if requested.
    context : StageContext
        Technique and settings.
    """
    if "noise_free" in context.keep:
        image.kept["noise_free"] = simulate_readout(image.expected_signal, context.technique, None)
    values, seed = (image.expected_signal, None) if image.noisy is None else (image.noisy, context.make_noise_seed(1))
    image.pixels = simulate_readout(values, context.technique, seed, context.workers)


def _uses_central_rays(protocol: Protocol) -> bool:
    """Return whether the primary is computed with one ray from the centre of the focal spot to each pixel centre."""
    return protocol.focal_spot != "sampled" and protocol.subpixels < 2


def _casts_several_rays(protocol: Protocol) -> bool:
    """Return whether several rays per pixel are requested, or may be necessary."""
    return protocol.focal_spot == "sampled" or protocol.subpixels != 1


# All stages in the order of execution.
STAGES = (
    Stage("spectrum", _uses_central_rays, prepare_spectrum),
    Stage("attenuation", _uses_central_rays, attenuate, "paths"),
    Stage("sampled rays", _casts_several_rays, sample_rays, "paths"),
    Stage("scatter", lambda protocol: protocol.scatter == "kernel", add_kernel_scatter, "paths"),
    Stage("scatter", lambda protocol: protocol.scatter == "monte_carlo", add_monte_carlo_scatter, "paths"),
    Stage("grid", lambda protocol: protocol.grid_ratio > 0, apply_grid, "paths"),
    Stage("focal spot", lambda protocol: protocol.focal_spot_mm > 0 and protocol.focal_spot == "blur", blur_focal_spot),
    Stage("marker", lambda protocol: protocol.marker != "none", add_side_marker),
    Stage("quantum noise", lambda protocol: protocol.noise == "quantum", add_quantum_noise, "photons"),
    Stage("detector blur", lambda protocol: protocol.detector_blur != "none", blur_panel),
    Stage("readout", lambda protocol: True, read_out),
)


def select_stages(protocol: Protocol) -> list[Stage]:
    """Select the stages that a protocol needs, in the order of execution.

    Parameters
    ----------
    protocol : Protocol
        Protocol that determines which stages are needed.

    Returns
    -------
    list of Stage
        Stages that the protocol needs.
    """
    return [stage for stage in STAGES if stage.is_requested(protocol)]


def run_stages(image: LatentImage, context: StageContext) -> dict[str, float]:
    """Run the stages that the protocol of a context needs.

    Parameters
    ----------
    image : LatentImage
        Image with path lengths; pixels and requested intermediate maps are set, and other maps are released.
    context : StageContext
        Technique and settings.

    Returns
    -------
    dict of str to float
        Run time of each stage, in s.

    Raises
    ------
    InputError
        If a stage receives invalid input.
    """
    clock, stages = Timer(), select_stages(context.technique.protocol)
    for place, stage in enumerate(stages, 1):
        stage.run(image, context)
        clock.lap(stage.name)
        _drop_unread_maps(image, {later.reads for later in stages[place:]}, context.keep)
    return clock.seconds


def _drop_unread_maps(image: LatentImage, read_later: set[str | None], keep: frozenset[str]) -> None:
    """Release the maps that no later stage uses, because one map of a large detector needs 250 MB of memory."""
    if "paths" in read_later or image.primary is None:
        return
    image.path_mm = {}
    for name, held in (("primary", image.primary.kev), ("scatter", image.scatter)):
        if name in keep and held is not None:
            image.kept.setdefault(name, held)
    signal = image.expected_signal
    # Quantum noise uses only the photon energy map of the primary; the primary signal is therefore replaced by the
    # total signal.
    image.primary = Signal(signal, image.primary.photon_kev) if "photons" in read_later else None
    image.scatter = None
