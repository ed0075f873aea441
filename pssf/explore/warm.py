"""Warm: what stays between requests, so that a stage is run again only when what it depends on has changed.

Knees are kept by their parameters and posture, path lengths by knee and view, and of each path the image after every
stage of the chain. A request takes the last image that no field that has changed was read for.
"""

import copy
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields
from typing import Any

from ..anatomy import BuiltKnee, build
from ..core.timer import Timer
from ..core.workers import one_blas_thread
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Truth
from ..raycast import Paths, trace
from ..stages import STAGES, Chain, LatentImage, Stage, stages_of
from ..xray.technique import Technique, technique_of

# One engine, whose bytes the lines of Python give again.
ENGINE = "scanline"
# Knees that are kept, and pixels of all path lengths and images; the newest is kept whatever its size.
_KNEES, _MOST_PIXELS = 6, 10_000_000
# Name of the first stage that reads a field. All others count as read by the first stage of all.
_READ_BY = {
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
# An image is not kept after these, which take little time and would hold a copy each.
_NOT_KEPT = ("detector blur", "readout")


@dataclass
class Traced:
    """Path lengths of a knee in one view, and how far its last image came.

    truth   what is known of the view, once it was asked for
    images  after each of the stages that were run for `protocol` and `seed`
    """

    paths: Paths
    truth: Truth | None = None
    protocol: Protocol | None = None
    seed: int = 0
    images: list[LatentImage] = field(default_factory=list)


@dataclass(kw_only=True)
class Exposed:
    """What a request made.

    technique  of the protocol with the beam fitted to the knee
    rays       that were traced for it; 0 where path lengths were kept
    seconds    of the stages that were run
    """

    built: BuiltKnee
    traced: Traced
    technique: Technique
    image: LatentImage
    rays: int
    seconds: dict[str, float]

    @property
    def protocol(self) -> Protocol:
        """That the radiograph was taken by."""
        return self.technique.protocol

    @property
    def truth(self) -> Truth:
        """Labels; the same for all exposures of a view."""
        if self.traced.truth is None:
            self.traced.truth = self.built.truth(self.protocol)
        return self.traced.truth


class Warm:
    """Knees, path lengths and images that are kept.

    step  is called before each stage, and raises where the work is no longer wanted
    """

    def __init__(self, step: Callable[[], None] = lambda: None, workers: int = 2) -> None:
        self._step, self._workers = step, workers
        self._knees: OrderedDict[Hashable, BuiltKnee] = OrderedDict()
        self._traced: OrderedDict[Hashable, Traced] = OrderedDict()

    def built(self, knee: Knee, protocol: Protocol) -> BuiltKnee:
        """A knee in the posture of a protocol.

        raises  InputError for one that cannot be built
        """
        key = (knee, protocol.posture)
        if key not in self._knees:
            self._step()
            self._knees[key] = build(knee, protocol)
        self._knees.move_to_end(key)
        while len(self._knees) > _KNEES:
            self._knees.popitem(last=False)
        return self._knees[key]

    def known(self, knee: Knee, protocol: Protocol) -> Paths | None:
        """The path lengths of a knee under a protocol where they are kept."""
        built = self._knees.get((knee, protocol.posture))
        traced = None if built is None else self._traced.get(_view_key(built, built.aimed(protocol)))
        return None if traced is None else traced.paths

    def exposed(self, knee: Knee, protocol: Protocol, seed: int) -> Exposed:
        """A radiograph of a knee, up to its pixels.

        raises  InputError as `simulate`; whatever `step` raises
        """
        clock = Timer()
        built = self.built(knee, protocol)
        technique = technique_of(built.aimed(protocol))
        clock.lap("anatomy")
        traced, rays = self._paths(built, technique.protocol)
        clock.lap("rays")
        image = self._developed(built, traced, technique, seed, clock)
        return Exposed(built=built, traced=traced, technique=technique, image=image, rays=rays, seconds=clock.seconds)

    def _paths(self, built: BuiltKnee, protocol: Protocol) -> tuple[Traced, int]:
        """Path lengths, and how many rays were traced for them now."""
        key, rays = _view_key(built, protocol), 0
        if key not in self._traced:
            self._step()
            paths = trace(built.scene, protocol, engine=ENGINE, workers=self._workers)
            self._traced[key], rays = Traced(paths), paths.audit.rays
        self._traced.move_to_end(key)
        while len(self._traced) > 1 and sum(map(_pixels, self._traced.values())) > _MOST_PIXELS:
            self._traced.popitem(last=False)
        return self._traced[key], rays

    @one_blas_thread()
    def _developed(
        self, built: BuiltKnee, traced: Traced, technique: Technique, seed: int, clock: Timer
    ) -> LatentImage:
        chain = Chain(technique=technique, engine=ENGINE, seed=seed, workers=self._workers)
        protocol, stages = technique.protocol, stages_of(technique.protocol)
        done = _unchanged(traced, protocol, seed, stages)
        kept = traced.images[:done]
        # What was kept of other values is gone before the work, which may be given up half-way.
        traced.images, traced.protocol, traced.seed = kept, protocol, seed
        image = _copied(kept[-1]) if kept else LatentImage(path_mm=traced.paths.path_mm, scene=built.scene)
        for stage in stages[len(kept) :]:
            self._step()
            stage.run(image, chain)
            clock.lap(stage.name)
            if stage.name not in _NOT_KEPT and len(traced.images) == stages.index(stage):
                traced.images.append(_copied(image))
        return image


def _view_key(built: BuiltKnee, protocol: Protocol) -> Hashable:
    geometry = ("sdd_mm", "sod_mm", "beam_angle_deg", "centre_x_mm", "centre_z_mm", "rows", "cols", "pixel_mm")
    return (built.knee, protocol.posture, protocol.texture, *(getattr(protocol, name) for name in geometry))


def _pixels(traced: Traced) -> int:
    return traced.paths.view.rows * traced.paths.view.cols


def _unchanged(traced: Traced, protocol: Protocol, seed: int, stages: list[Stage]) -> int:
    """How many of the first stages would give again what is kept."""
    if traced.protocol is None:
        return 0
    before = stages_of(traced.protocol)
    same = next((k for k, (one, other) in enumerate(zip(before, stages, strict=False)) if one is not other), None)
    least = min(len(before), len(stages)) if same is None else same
    for one in fields(Protocol):
        if getattr(protocol, one.name) != getattr(traced.protocol, one.name):
            least = min(least, _reader(_READ_BY.get(one.name, STAGES[0].name), stages))
    if seed != traced.seed:
        by_photons = protocol.scatter == "monte_carlo"
        least = min(least, _reader("scatter" if by_photons else "quantum noise", stages))
        least = min(least, _reader("readout", stages))
    return min(least, len(traced.images))


def _reader(name: str, stages: list[Stage]) -> int:
    """Place of the stage of that name; the first where there is none after it, so that none is taken for unread."""
    names = [stage.name for stage in stages]
    order = [stage.name for stage in STAGES]
    later = set(order[order.index(name) :])
    return next((k for k, one in enumerate(names) if one in later), 0)


def _copied(image: LatentImage) -> LatentImage:
    """An image that stays as it is when stages go on with the other one; two of its maps they change in place."""
    kept: Any = copy.copy(image)
    kept.kept = dict(image.kept)
    for name in ("frequencies", "noisy"):
        values = getattr(image, name)
        setattr(kept, name, None if values is None else values.copy())
    return kept
