"""Cache of knees, path lengths and images, so that only stages with changed inputs run again.

Knees are cached by parameters and posture, and path lengths are cached by knee and view. For each view, the image after
each stage is cached. A request starts from the last cached image that the changed fields do not affect.
"""

import copy
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields
from typing import Any

from ..anatomy import BuiltKnee, build
from ..core.processes.worker_processes import limit_to_one_blas_thread
from ..core.stage_timer import Timer
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Truth
from ..raycast import Paths, trace
from ..stages import (
    STAGES,
    LatentImage,
    Stage,
    StageContext,
    select_stages,
)
from ..xray.resolved_technique import Technique, resolve_technique

# Ray-casting engine. The Python code on the explore page specifies the same engine to reproduce identical pixels.
ENGINE = "scanline"
# Maximum number of cached knees.
_KNEES = 6
# Maximum total number of pixels in all cached views. The newest view is always retained.
_MOST_PIXELS = 10_000_000
# First stage that depends on each protocol field. A protocol field that is not listed affects all stages.
_FIRST_STAGE_BY_FIELD = {
    "name": "readout",
    "scatter": "scatter",
    "scatter_photons": "scatter",
    "grid_ratio": "attenuation",
    "grid_lines_per_cm": "attenuation",
    "marker": "marker",
    "noise": "quantum noise",
    "detector_blur": "detector blur",
    "dead_pixels": "readout",
}
# Stages whose images are not cached, because the stages are fast and a cached image requires memory.
_UNCACHED_STAGES = ("detector blur", "readout")


@dataclass
class CachedPaths:
    """Path lengths of a knee in one view, with the images of the last request for the view.

    Attributes
    ----------
    paths : Paths
        Path lengths of all pixels.
    truth : Truth or None
        Labels for the view; None until labels are requested.
    protocol : Protocol or None
        Protocol with which the images were simulated; None before the first request.
    seed : int
        Noise seed with which the images were simulated.
    images : list of LatentImage
        Image after each completed stage.
    """

    paths: Paths
    truth: Truth | None = None
    protocol: Protocol | None = None
    seed: int = 0
    images: list[LatentImage] = field(default_factory=list)


@dataclass(kw_only=True)
class SimulatedImage:
    """Result of a request for a radiograph.

    Attributes
    ----------
    built : BuiltKnee
        Built knee with its surfaces.
    cached_paths : CachedPaths
        Cached path lengths for the view.
    technique : Technique
        Resolved protocol, with the beam aligned with the knee.
    image : LatentImage
        Image after the last stage.
    rays_traced : int
        Number of rays cast for the request; 0 if the path lengths were cached.
    seconds : dict of str to float
        Computing time of each stage, in s, keyed by stage name.
    """

    built: BuiltKnee
    cached_paths: CachedPaths
    technique: Technique
    image: LatentImage
    rays_traced: int
    seconds: dict[str, float]

    @property
    def protocol(self) -> Protocol:
        """Protocol of the radiograph, with the beam aligned with the knee."""
        return self.technique.protocol

    @property
    def truth(self) -> Truth:
        """Labels for the view, which do not depend on the exposure."""
        if self.cached_paths.truth is None:
            self.cached_paths.truth = self.built.truth(self.protocol)
        return self.cached_paths.truth


class StageCache:
    """Cache of knees, path lengths and images.

    Parameters
    ----------
    step : callable, optional
        Function that is called before each stage. The function raises an exception to cancel the request.
    workers : int, default 2
        Number of threads.
    """

    def __init__(self, step: Callable[[], None] = lambda: None, workers: int = 2) -> None:
        self._step, self._workers = step, workers
        self._knees: OrderedDict[Hashable, BuiltKnee] = OrderedDict()
        self._traced: OrderedDict[Hashable, CachedPaths] = OrderedDict()

    def build_knee(self, knee: Knee, protocol: Protocol) -> BuiltKnee:
        """Build a knee in the posture of a protocol, or return it from the cache.

        Parameters
        ----------
        knee : Knee
            Parameters of the knee.
        protocol : Protocol
            Protocol that defines the posture.

        Returns
        -------
        BuiltKnee
            Built knee with its surfaces.

        Raises
        ------
        InputError
            If the knee cannot be built.
        """
        key = (knee, protocol.posture)
        if key not in self._knees:
            self._step()
            self._knees[key] = build(knee, protocol)
        self._knees.move_to_end(key)
        while len(self._knees) > _KNEES:
            self._knees.popitem(last=False)
        return self._knees[key]

    def find_paths(self, knee: Knee, protocol: Protocol) -> Paths | None:
        """Return the cached path lengths for a knee and a protocol.

        Parameters
        ----------
        knee : Knee
            Parameters of the knee.
        protocol : Protocol
            Acquisition protocol.

        Returns
        -------
        Paths or None
            Path lengths; None if the cache does not contain the path lengths.
        """
        built = self._knees.get((knee, protocol.posture))
        traced = None if built is None else self._traced.get(_view_key(built, built.aim_beam(protocol)))
        return None if traced is None else traced.paths

    def simulate_image(self, knee: Knee, protocol: Protocol, seed: int) -> SimulatedImage:
        """Simulate a radiograph of a knee, starting from cached stages if possible.

        Parameters
        ----------
        knee : Knee
            Parameters of the knee.
        protocol : Protocol
            Acquisition protocol.
        seed : int
            Noise seed.

        Returns
        -------
        SimulatedImage
            Image with its pixels, path lengths and computing times.

        Raises
        ------
        InputError
            Under the same conditions as in `pssf.simulate`. Exceptions from `step` are not caught.
        """
        clock = Timer()
        built = self.build_knee(knee, protocol)
        technique = resolve_technique(built.aim_beam(protocol))
        clock.lap("anatomy")
        traced, rays = self._trace_paths(built, technique.protocol)
        clock.lap("rays")
        image = self._run_stages(built, traced, technique, seed, clock)
        return SimulatedImage(
            built=built, cached_paths=traced, technique=technique, image=image, rays_traced=rays, seconds=clock.seconds
        )

    def _trace_paths(self, built: BuiltKnee, protocol: Protocol) -> tuple[CachedPaths, int]:
        """Return the path lengths of a knee and the number of rays cast, which is 0 for cached path lengths."""
        key, rays = _view_key(built, protocol), 0
        if key not in self._traced:
            self._step()
            paths = trace(built.scene, protocol, engine=ENGINE, workers=self._workers)
            self._traced[key], rays = CachedPaths(paths), paths.audit.rays
        self._traced.move_to_end(key)
        while len(self._traced) > 1 and sum(map(_count_pixels, self._traced.values())) > _MOST_PIXELS:
            self._traced.popitem(last=False)
        return self._traced[key], rays

    @limit_to_one_blas_thread()
    def _run_stages(
        self, built: BuiltKnee, traced: CachedPaths, technique: Technique, seed: int, clock: Timer
    ) -> LatentImage:
        """Run all stages whose inputs have changed, and cache the resulting images."""
        chain = StageContext(technique=technique, engine=ENGINE, seed=seed, workers=self._workers)
        protocol, stages = technique.protocol, select_stages(technique.protocol)
        done = _count_valid_stages(traced, protocol, seed, stages)
        kept = traced.images[:done]
        # Outdated images are removed first, because the request may be cancelled before all stages have run.
        traced.images, traced.protocol, traced.seed = kept, protocol, seed
        image = _copy_image(kept[-1]) if kept else LatentImage(path_mm=traced.paths.path_mm, scene=built.scene)
        for stage in stages[len(kept) :]:
            self._step()
            stage.run(image, chain)
            clock.lap(stage.name)
            if stage.name not in _UNCACHED_STAGES and len(traced.images) == stages.index(stage):
                traced.images.append(_copy_image(image))
        return image


def _view_key(built: BuiltKnee, protocol: Protocol) -> Hashable:
    """Return the cache key of a view: knee, posture and the fields that affect path lengths."""
    geometry = (
        "sdd_mm", "sod_mm", "beam_angle_deg", "centre_x_mm", "centre_z_mm", "detector_offset_x_mm",
        "detector_offset_z_mm", "rows", "cols", "pixel_mm",
    )  # fmt: skip
    return (built.knee, protocol.posture, protocol.texture, *(getattr(protocol, name) for name in geometry))


def _count_pixels(traced: CachedPaths) -> int:
    """Return the number of pixels in a cached view."""
    return traced.paths.view.rows * traced.paths.view.cols


def _count_valid_stages(traced: CachedPaths, protocol: Protocol, seed: int, stages: list[Stage]) -> int:
    """Count the leading stages whose cached images are still valid."""
    if traced.protocol is None:
        return 0
    before = select_stages(traced.protocol)
    same = next((k for k, (one, other) in enumerate(zip(before, stages, strict=False)) if one is not other), None)
    least = min(len(before), len(stages)) if same is None else same
    for one in fields(Protocol):
        if getattr(protocol, one.name) != getattr(traced.protocol, one.name):
            least = min(least, _first_stage_index(_FIRST_STAGE_BY_FIELD.get(one.name, STAGES[0].name), stages))
    if seed != traced.seed:
        by_photons = protocol.scatter == "monte_carlo"
        least = min(least, _first_stage_index("scatter" if by_photons else "quantum noise", stages))
        least = min(least, _first_stage_index("readout", stages))
    return min(least, len(traced.images))


def _first_stage_index(name: str, stages: list[Stage]) -> int:
    """Return the index of a stage in `stages`, or of the first later stage if the stage is not in `stages`.

    If `stages` contains no later stage, the index is 0, so that all stages run again.
    """
    names = [stage.name for stage in stages]
    order = [stage.name for stage in STAGES]
    later = set(order[order.index(name) :])
    return next((k for k, one in enumerate(names) if one in later), 0)


def _copy_image(image: LatentImage) -> LatentImage:
    """Copy an image, including the arrays `frequencies` and `noisy`, which later stages modify in place."""
    kept: Any = copy.copy(image)
    kept.kept = dict(image.kept)
    for name in ("frequencies", "noisy"):
        values = getattr(image, name)
        setattr(kept, name, None if values is None else values.copy())
    return kept
