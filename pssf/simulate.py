"""simulate: a knee, or any scene, and a protocol -> a radiograph."""

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from importlib.metadata import version

import numpy as np

from . import anatomy, raycast
from . import exposure as detector
from .core.checks import InputError, require_choice, require_seed, require_workers
from .core.timer import Clock
from .geometry.scene import Scene
from .geometry.view import spot_views, view_of
from .model.knee import Knee
from .model.protocol import Protocol
from .model.radiograph import Radiograph, Truth
from .scatter.kernel import exit_gap_mm
from .scatter.monte_carlo import scatter_monte_carlo

KEEP = ("path_mm", "primary", "scatter", "noise_free", "masks")
# Streams below a radiograph's seed; shape and pose are drawn with the knee, before it.
_NOISE = 3


def simulate(
    knee: Knee | Scene,
    protocol: Protocol,
    *,
    seed: int = 0,
    keep: Collection[str] = (),
    engine: str = "embree",
    workers: int = 2,
    scene: Scene | None = None,
    paths: raycast.Paths | None = None,
) -> Radiograph:
    """A radiograph of a knee, or of a scene of one's own.

    seed     of the noise; the same seed gives the same bytes on any number of workers
    keep     maps to hold in `kept`, of "path_mm", "primary", "scatter", "noise_free"; and "masks", for a knee's `truth`
    engine   "embree" or "scanline"
    workers  threads
    scene    what `build(knee)` gave, where several protocols see the same knee
    paths    what `trace` gave for this knee, where several protocols see it from the same place
    raises   InputError for an unknown name in keep, an unknown engine or material, a scene that cannot be traced, paths
             of another view
    """
    _check(knee, protocol, seed, keep, engine, workers)
    clock = Clock()
    who = None if isinstance(knee, Scene) else knee
    scene = knee if isinstance(knee, Scene) else scene or anatomy.build(knee)
    clock.lap("anatomy")
    detector.check_materials(scene.materials)
    if paths is None:
        paths = raycast.trace(scene, protocol, engine=engine, workers=workers)
    _check_paths(paths, protocol)
    gap_mm = exit_gap_mm(scene, view_of(protocol)) if detector.needs_gap(protocol) else 0.0
    clock.lap("rays")
    primary = scatter = error = None
    if protocol.focal_spot == "sampled":
        primary = sampled_primary(scene, protocol, engine, workers)
        clock.lap("focal spot")
    if protocol.scatter == "monte_carlo":
        scatter, error = scatter_monte_carlo(
            scene, protocol, photons=protocol.scatter_photons, seed=seed, workers=workers
        )
        clock.lap("scatter")
    noise = np.random.SeedSequence(seed, spawn_key=(_NOISE,))
    pixels, kept, stages = detector.expose(
        paths.path_mm, protocol, gap_mm=gap_mm, seed=noise, primary=primary, scatter=scatter, keep=keep, workers=workers
    )
    if "path_mm" in keep:
        kept["path_mm"] = paths.path_mm
    if "scatter" in keep and error is not None:
        kept["scatter_error"] = error
    return Radiograph(
        pixels=pixels,
        protocol=protocol,
        seed=seed,
        knee=who,
        truth=None if who is None else _truth(who, scene, protocol, "masks" in keep),
        engine=engine,
        audit=paths.audit.counts(),
        versions=versions(),
        kept=kept,
        seconds={**clock.seconds, **stages},
    )


def _check(knee: Knee | Scene, protocol: Protocol, seed: int, keep: Collection[str], engine: str, workers: int) -> None:
    require_choice("engine", engine, raycast.ENGINES)
    require_workers(workers)
    require_seed(seed)
    for name in keep:
        require_choice("keep", name, KEEP)
    if "masks" in keep and isinstance(knee, Scene):
        raise InputError("keep = masks of a scene; allowed: of a Knee, whose bones are known by name")
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol = {protocol!r}; allowed: a Protocol, as load_protocol gives it")
    if not isinstance(knee, Knee | Scene):
        raise InputError(f"knee = {knee!r}; allowed: a Knee or a Scene")


def sampled_primary(scene: Scene, protocol: Protocol, engine: str, workers: int, points: int = 3) -> detector.Signal:
    """Primary signal as the mean over rays from points of the focal spot, so many a side (`geometry.spot_views`)."""
    kev, square = (np.zeros((protocol.rows, protocol.cols), np.float32) for _ in range(2))
    for view, share in spot_views(protocol, points):
        paths = raycast.trace(scene, view, engine=engine, texture=protocol.texture != "none", workers=workers)
        one = detector.primary_of(paths.path_mm, protocol, workers, view)
        kev += np.float32(share) * one.kev
        square += np.float32(share) * one.kev * one.photon_kev
    return detector.Signal(kev, np.divide(square, kev, out=np.zeros_like(kev), where=kev > 0))


def _truth(knee: Knee, scene: Scene, protocol: Protocol, masked: bool) -> Truth:
    truth = anatomy.truth_of(knee, scene, protocol)
    if not masked:
        return truth
    solids = {surface.name: surface.mesh for surface in scene.surfaces if surface.name in anatomy.BONES}
    solids |= {f"{site}_osteophyte": mesh for site, mesh in anatomy.osteophytes_of(knee).items()}
    return replace(truth, masks={name: raycast.shadow(mesh, protocol) for name, mesh in solids.items()})


def _check_paths(paths: raycast.Paths, protocol: Protocol) -> None:
    """They are the protocol's; and no material is crossed by less than nothing, as where an `outside` is wrong."""
    if paths.view != view_of(protocol):
        raise InputError(f"paths of {paths.view}; allowed: of {view_of(protocol)}, as the protocol sees it")
    if paths.texture != protocol.texture:
        raise InputError(f"paths with texture = {paths.texture}; allowed: {protocol.texture}, as in the protocol")
    for material, lengths in paths.path_mm.items():
        least = float(lengths.min())
        if least < -1e-3:
            why = "a surface has it outside where it is not, or two surfaces overlap"
            raise InputError(f"{material}: path length {least:.4g} mm ({why}); allowed: 0 mm or more")


@cache
def versions() -> dict[str, str]:
    """Versions of the package and of all that its pixels depend on."""
    names = ("pssf", "embreex", "manifold3d", "numba", "numpy", "scipy", "spekpy", "trimesh", "xraylib")
    return {name: version(name) for name in names}
