"""simulate: a knee, or any scene, and a protocol -> a radiograph."""

import warnings
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from os import PathLike
from typing import Any

from .anatomy import BuiltKnee, BuiltPair, build, build_pair, make_texture
from .core.checks import Chance, InputError, require_choice, require_workers, seed_of
from .core.keywords import keywords
from .core.timer import Timer
from .core.workers import one_blas_thread
from .geometry.mesh import Mesh
from .geometry.scene import Scene
from .geometry.view import view_of
from .image_faults import (
    ImageNotice,
    field_faults,
    landmark_faults,
    material_faults,
    require_materials,
    saturation_faults,
)
from .model.knee import Knee
from .model.protocol import Protocol, load_protocol
from .model.radiograph import Radiograph, Truth
from .precompile import compiling_aside
from .raycast import ENGINES, Audit, Paths, shadow, trace, trace_strips
from .raycast.room import require_room
from .stages import Chain, LatentImage, expose
from .xray.collimator import field_half_mm
from .xray.technique import Technique, technique_of

KEEP = ("path_mm", "primary", "scatter", "noise_free", "masks")
Subject = Knee | BuiltKnee | BuiltPair | Scene | tuple[Knee | BuiltKnee, Knee | BuiltKnee]
_ALONG_THE_LEG = (
    "scatter = 'kernel' along the leg, which it was not fitted to: some 30 % too much (protocols/README.md); "
    "'monte_carlo' holds in every view"
)


class KernelNotice(UserWarning):
    """The kernel of scatter was asked for where it does not hold; the message says by how much."""


@keywords(seed="rng")
@one_blas_thread()
def simulate(
    knee: Subject,
    protocol: Protocol | str | PathLike[str],
    *,
    rng: Chance = 0,
    keep: Collection[str] = (),
    engine: str = "embree",
    workers: int = 2,
    paths: Paths | None = None,
) -> Radiograph:
    """Simulate a radiograph of a knee, of both knees of a person, or of a scene.

    Parameters
    ----------
    knee : Knee, BuiltKnee, (right, left) pair, BuiltPair or Scene
        A knee; what `build` made of it, where several protocols share a posture; right and left knee for a protocol
        that images both (`apart_mm`); or a scene, which is traced where it stands.
    protocol : Protocol or str
        Technique, geometry and detector; a name or path is loaded with `load_protocol`.
    rng : int or numpy.random.Generator, default 0
        Chance of the noise. The same integer gives the same bytes on any number of workers; a Generator draws the
        integer, which the radiograph keeps as `seed`.
    keep : collection of str
        Maps to hold in `Radiograph.kept`: "path_mm", "primary", "scatter", "noise_free"; and "masks", for a knee's
        `truth`.
    engine : {"embree", "scanline"}
        Ray caster; both agree to 1e-9 mm.
    workers : int
        Threads; they do not change the result.
    paths : Paths, optional
        From `trace` of this scene, where several protocols see it from the same place.

    Returns
    -------
    Radiograph

    Raises
    ------
    InputError
        For an unknown name, a scene that cannot be traced, paths of another scene or view, or a detector that leaves no
        room for the knee.

    Warns
    -----
    KernelNotice
        For the scatter kernel along the leg or in a small field, with the factor by which it is off.
    ImageNotice
        For saturation within the object, a scene or landmarks outside the image, and a formula that looks like the name
        of an alloy.

    Examples
    --------
    >>> import dataclasses, pssf
    >>> protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=64, cols=64, pixel_mm=4.8)
    >>> radiograph = pssf.simulate(pssf.Knee(), protocol, rng=7, engine="scanline")
    >>> radiograph.pixels.shape, radiograph.truth.grade
    ((64, 64), 0)
    """
    if isinstance(protocol, str | PathLike):
        protocol = load_protocol(protocol)
    seed = seed_of(rng)
    _check(knee, protocol, keep, engine, workers)
    clock = Timer()
    subject = _built(knee, protocol, engine, workers)
    # What a radiograph keeps is the beam as it was, not how it was found.
    protocol = subject.aimed(protocol) if isinstance(subject, BuiltKnee) else protocol
    technique = technique_of(protocol)
    scene = subject if isinstance(subject, Scene) else subject.scene
    if not isinstance(subject, Scene):
        require_room(scene, protocol)
    clock.lap("anatomy")
    require_materials(scene, technique)  # refused before rays are cast
    chain = Chain(technique=technique, engine=engine, seed=seed, keep=frozenset(keep), workers=workers)
    image, audit = _traced(scene, chain, paths)
    clock.lap("rays")
    faults = [*material_faults(scene, technique), *(outside := field_faults(image.path_mm, technique))]
    with ThreadPoolExecutor(1) as aside:
        known = aside.submit(_known, subject, protocol, keep)
        seconds = expose(image, chain)
    wanted = [*keep, "scatter_error"] if "scatter" in keep else list(keep)
    assert image.pixels is not None
    made = Radiograph(
        pixels=image.pixels,
        protocol=protocol,
        seed=seed,
        **known.result(),
        engine=engine,
        audit=audit.counts(),
        versions=versions(),
        kept={name: image.kept[name] for name in wanted if name in image.kept},
        seconds={**clock.seconds, **seconds},
    )
    faults += saturation_faults(made.pixels, scene, technique)
    if not outside:
        faults += landmark_faults((made.truth,) if made.truth else made.truths, technique)
    for notice in [*_off_kernel(technique), *map(ImageNotice, faults)]:
        warnings.warn(notice, stacklevel=4)
    return made


def _off_kernel(technique: Technique) -> list[KernelNotice]:
    """What the kernel of scatter, if it is asked for, does not hold for, and by how much."""
    protocol = technique.protocol
    if protocol.scatter != "kernel":
        return []
    if protocol.projection == "axial":
        return [KernelNotice(_ALONG_THE_LEG)]
    width_mm, height_mm = (2 * half for half in field_half_mm(technique))
    off = technique.kernel.small_field(width_mm, height_mm)
    if off is None:
        return []
    least = " x ".join(f"{side:g}" for side in technique.kernel.full_field_mm)
    return [
        KernelNotice(
            f"scatter = 'kernel' with a field of {width_mm:.0f} x {height_mm:.0f} mm, less than {least} mm, which it "
            f"was not fitted to; scatter at the joint is {off.low:g} to {off.high:g} times that of a Monte Carlo; "
            "scatter = 'monte_carlo' holds for every field"
        )
    ]


def _check(knee: Subject, protocol: Protocol, keep: Collection[str], engine: str, workers: int) -> None:
    require_choice("engine", engine, ENGINES)
    require_workers(workers)
    if isinstance(keep, str) or not isinstance(keep, Collection):
        raise InputError(f"keep = {keep!r}; allowed: a list of any of {', '.join(KEEP)}")
    for name in keep:
        require_choice("keep", name, KEEP)
    if "masks" in keep and isinstance(knee, Scene):
        raise InputError("keep = masks of a scene; allowed: of a Knee, whose bones are known by name")
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol = {protocol!r}; allowed: a Protocol, as load_protocol gives it")
    pair = isinstance(knee, tuple) and len(knee) == 2
    knees: Any = knee.knees if isinstance(knee, BuiltPair) else knee if pair else (knee,)
    for one in knees:
        _check_one(one, protocol)
    if isinstance(knee, Knee | BuiltKnee) and protocol.apart_mm:
        raise InputError(
            f"apart_mm = {protocol.apart_mm:g} mm with one knee; allowed: 0, or simulate((right, left), ...)"
        )
    if isinstance(knee, BuiltPair) and knee.apart_mm != protocol.apart_mm:
        raise InputError(f"apart_mm = {protocol.apart_mm:g} mm; allowed: {knee.apart_mm:g} mm, as the knees were built")


def _check_one(knee: object, protocol: Protocol) -> None:
    if not isinstance(knee, Knee | BuiltKnee | Scene):
        raise InputError(f"knee = {knee!r}; allowed: a Knee, a BuiltKnee, a right and a left one, or a Scene")
    if isinstance(knee, BuiltKnee) and knee.assembly.posture != protocol.posture:
        raise InputError(
            f"knee built in {knee.assembly.posture}; allowed: {protocol.posture}, as build(knee, protocol) makes it"
        )


def _built(knee: Subject, protocol: Protocol, engine: str, workers: int) -> BuiltKnee | BuiltPair | Scene:
    if not isinstance(knee, Knee | tuple):
        return knee
    textured = protocol.texture != "none"
    with ThreadPoolExecutor(1) as aside, compiling_aside(engine, textured=textured, workers=workers):
        if isinstance(knee, tuple):
            return build_pair(*knee, protocol)
        if workers > 1 and textured:
            aside.submit(make_texture, knee)
        return build(knee, protocol)


def _traced(scene: Scene, chain: Chain, paths: Paths | None) -> tuple[LatentImage, Audit]:
    """What the stages start from, and the audit of its rays; in strips where nobody asked for the path lengths."""
    protocol = chain.technique.protocol
    if paths is None and "path_mm" not in chain.keep:
        path_mm, audit = trace_strips(scene, protocol, engine=chain.engine, workers=chain.workers)
        return LatentImage(path_mm=path_mm, scene=scene), audit
    if paths is None:
        paths = trace(scene, protocol, engine=chain.engine, workers=chain.workers)
    _check_paths(paths, scene, protocol)
    return LatentImage(path_mm=paths.path_mm, scene=scene, kept={"path_mm": paths.path_mm}), paths.audit


def _known(subject: BuiltKnee | BuiltPair | Scene, protocol: Protocol, keep: Collection[str]) -> dict[str, Any]:
    """Fields of a radiograph that say of what it is."""
    masked = "masks" in keep
    if isinstance(subject, BuiltKnee):
        truth = subject.truth(protocol)
        truth = _masked(truth, subject.solids(), protocol) if masked else truth
        return {"knee": subject.knee, "truth": truth, "surgery": subject.surgery_table()}
    if isinstance(subject, BuiltPair):
        truths = subject.truths(protocol)
        if masked:
            pairs = zip(truths, subject.solids(), strict=True)
            truths = tuple(_masked(truth, solids, protocol) for truth, solids in pairs)
        surgery = tuple(step for built in subject.knees for step in built.surgery_table(f"{built.knee.side}_"))
        return {"knees": tuple(built.knee for built in subject.knees), "truths": truths, "surgery": surgery}
    return {"scene": subject.table()}


def _masked(truth: Truth, solids: dict[str, Mesh], protocol: Protocol) -> Truth:
    return replace(truth, masks={name: shadow(mesh, protocol) for name, mesh in solids.items()})


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
