"""simulate: a knee, or any scene, and a protocol -> a radiograph."""

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from importlib.metadata import version

from .anatomy import BuiltKnee, build
from .core.checks import InputError, require_choice, require_seed, require_workers
from .core.timer import Timer
from .geometry.scene import Scene
from .geometry.view import view_of
from .model.knee import Knee
from .model.protocol import Protocol
from .model.radiograph import Radiograph, Truth
from .raycast import ENGINES, Paths, shadow, trace
from .stages import Chain, LatentImage, expose
from .xray.materials import check_materials
from .xray.technique import technique_of

KEEP = ("path_mm", "primary", "scatter", "noise_free", "masks")


def simulate(
    knee: Knee | BuiltKnee | Scene,
    protocol: Protocol,
    *,
    seed: int = 0,
    keep: Collection[str] = (),
    engine: str = "embree",
    workers: int = 2,
    paths: Paths | None = None,
) -> Radiograph:
    """A radiograph of a knee, or of a scene of one's own.

    knee     a Knee; what `build` made of one, where several protocols see it in one posture; or a scene of one's own,
             which stands in the room as it is
    seed     of the noise; the same seed gives the same bytes on any number of workers
    keep     maps to hold in `kept`, of "path_mm", "primary", "scatter", "noise_free"; and "masks", for a knee's `truth`
    engine   "embree" or "scanline"
    workers  threads
    paths    what `trace` gave for this scene, where several protocols see it from the same place
    raises   InputError for an unknown name in keep, an unknown engine or material, a scene that cannot be traced, paths
             of another scene or view
    """
    _check(knee, protocol, seed, keep, engine, workers)
    clock, technique = Timer(), technique_of(protocol)
    subject = build(knee, protocol) if isinstance(knee, Knee) else knee
    built = subject if isinstance(subject, BuiltKnee) else None
    scene = subject.scene if isinstance(subject, BuiltKnee) else subject
    clock.lap("anatomy")
    check_materials(scene.materials)
    if paths is None:
        paths = trace(scene, protocol, engine=engine, workers=workers)
    _check_paths(paths, scene, protocol)
    clock.lap("rays")
    chain = Chain(technique=technique, engine=engine, seed=seed, keep=frozenset(keep), workers=workers)
    image = LatentImage(path_mm=paths.path_mm, scene=scene)
    seconds = expose(image, chain)
    kept = {**image.kept, "path_mm": paths.path_mm}
    wanted = [*keep, "scatter_error"] if "scatter" in keep else list(keep)
    assert image.pixels is not None
    return Radiograph(
        pixels=image.pixels,
        protocol=protocol,
        seed=seed,
        knee=None if built is None else built.knee,
        truth=None if built is None else _truth(built, protocol, keep),
        engine=engine,
        audit=paths.audit.counts(),
        versions=versions(),
        kept={name: kept[name] for name in wanted if name in kept},
        seconds={**clock.seconds, **seconds},
    )


def _check(
    knee: Knee | BuiltKnee | Scene, protocol: Protocol, seed: int, keep: Collection[str], engine: str, workers: int
) -> None:
    require_choice("engine", engine, ENGINES)
    require_workers(workers)
    require_seed(seed)
    for name in keep:
        require_choice("keep", name, KEEP)
    if "masks" in keep and isinstance(knee, Scene):
        raise InputError("keep = masks of a scene; allowed: of a Knee, whose bones are known by name")
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol = {protocol!r}; allowed: a Protocol, as load_protocol gives it")
    if not isinstance(knee, Knee | BuiltKnee | Scene):
        raise InputError(f"knee = {knee!r}; allowed: a Knee, a BuiltKnee or a Scene")
    if isinstance(knee, BuiltKnee) and knee.assembly.posture != protocol.posture:
        raise InputError(
            f"knee built in {knee.assembly.posture}; allowed: {protocol.posture}, as build(knee, protocol) makes it"
        )


def _truth(built: BuiltKnee, protocol: Protocol, keep: Collection[str]) -> Truth:
    truth = built.truth(protocol)
    if "masks" not in keep:
        return truth
    return replace(truth, masks={name: shadow(mesh, protocol) for name, mesh in built.solids().items()})


def _check_paths(paths: Paths, scene: Scene, protocol: Protocol) -> None:
    """They are of this scene, as this protocol sees it."""
    if not isinstance(paths, Paths):
        raise InputError(f"paths = {type(paths).__name__}; allowed: Paths, as trace gives them")
    if paths.scene is not scene:
        raise InputError(f"paths of another scene ({paths.scene!r}); allowed: of {scene!r}, which is simulated")
    if paths.view != view_of(protocol):
        raise InputError(f"paths of {paths.view}; allowed: of {view_of(protocol)}, as the protocol sees it")
    if paths.texture != protocol.texture:
        raise InputError(f"paths with texture = {paths.texture}; allowed: {protocol.texture}, as in the protocol")


@cache
def versions() -> dict[str, str]:
    """Versions of the package and of all that its pixels depend on."""
    names = ("pssf", "embreex", "manifold3d", "numba", "numpy", "scipy", "spekpy", "trimesh", "xraylib")
    return {name: version(name) for name in names}
