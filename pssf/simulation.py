"""Simulate a radiograph of one knee, of both knees, or of any other scene, with a protocol."""

import warnings
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from os import PathLike
from typing import Any

from .anatomy import (
    BuiltKnee,
    BuiltPair,
    build,
    build_pair,
    make_texture,
)
from .core.checks import (
    InputError,
    RNGLike,
    require_choice,
    require_workers,
    resolve_seed,
)
from .core.keyword_arguments import check_keywords
from .core.processes.worker_processes import limit_to_one_blas_thread
from .core.stage_timer import Timer
from .geometry.mesh import Mesh
from .geometry.scene import Scene
from .geometry.view import resolve_view
from .image_faults import (
    ImageNotice,
    find_field_faults,
    find_landmark_faults,
    find_material_faults,
    find_saturation_faults,
    require_materials,
)
from .model.knee import Knee
from .model.protocol import Protocol, load_protocol
from .model.radiograph import Radiograph, Truth
from .raycast import (
    ENGINES,
    Audit,
    Paths,
    compute_face_silhouette,
    find_overlap_faults,
    resolve_overlaps,
    trace,
    trace_sparse,
)
from .raycast.detector_clearance import require_detector_clearance
from .stages import LatentImage, StageContext, run_stages
from .xray.collimator import field_half_size_mm
from .xray.resolved_technique import Technique, resolve_technique

# Package and libraries whose versions affect the pixels.
PIXEL_LIBRARIES = ("pssf", "embreex", "manifold3d", "numba", "numpy", "scipy", "spekpy", "trimesh", "xraylib")
# Names of the intermediate maps that a radiograph can store.
KEEPABLE_MAPS = ("path_mm", "primary", "scatter", "noise_free", "masks")
# Types of objects that `simulate` accepts.
Subject = Knee | BuiltKnee | BuiltPair | Scene | tuple[Knee | BuiltKnee, Knee | BuiltKnee]
# Text of the warning that the scatter kernel is not fitted to axial views.
_AXIAL_KERNEL_WARNING = (
    "scatter = 'kernel' is not fitted to axial views, in which scatter around the joint is wrong by up to 30 % "
    "(docs/validation/views_and_quality.md); use scatter = 'monte_carlo', which is valid in every view"
)


class KernelNotice(UserWarning):
    """Warning that the scatter kernel is used outside its valid range; the message states the scatter error."""


@check_keywords(seed="rng")
@limit_to_one_blas_thread()
def simulate(
    knee: Subject,
    protocol: Protocol | str | PathLike[str],
    *,
    rng: RNGLike = 0,
    keep: Collection[str] = (),
    engine: str = "embree",
    workers: int = 2,
    paths: Paths | None = None,
) -> Radiograph:
    """Simulate a radiograph of one knee, of both knees of a patient, or of a scene.

    Parameters
    ----------
    knee : Knee, BuiltKnee, (right, left) pair, BuiltPair or Scene
        Object to image. A result of `build` can be used for several protocols with the same posture. A pair of knees
        requires a protocol that images both knees (`knee_distance_mm`). A scene is imaged without positioning.
    protocol : Protocol, str or path
        Technique, geometry and detector. A name or path is loaded with `load_protocol`.
    rng : int or numpy.random.Generator, default 0
        Seed of the noise. The same integer gives identical pixels for any number of workers. A Generator is used to
        sample an integer, which the radiograph stores as `seed`.
    keep : collection of str, default ()
        Maps to store in `Radiograph.kept`: ``"path_mm"``, ``"primary"``, ``"scatter"`` and ``"noise_free"``.
        ``"masks"`` adds the silhouettes of bones, osteophytes, cysts and implants to `truth`.
    engine : {"embree", "scanline"}, default "embree"
        Ray casting engine; the path lengths of the two engines agree within 1e-9 mm.
    workers : int, default 2
        Number of threads, from 1 to 256; it does not change the result.
    paths : Paths, optional
        Result of `trace` for the same scene and view. The path lengths can be used for several protocols with the same
        source and detector position.

    Returns
    -------
    Radiograph
        Pixels with protocol, seed, labels and provenance.

    Raises
    ------
    InputError
        If a name is unknown, the scene cannot be traced, `paths` belong to another scene or view, or the leg extends
        behind the detector.

    Warns
    -----
    KernelNotice
        If the scatter kernel is used in an axial view, a small field or an unusual beam; the message states the
        scatter error.
    ImageNotice
        If pixels within the object are saturated, the scene or landmarks are outside the image, bodies of a scene
        overlap, or a formula resembles the name of an alloy.
    MeshNotice
        If a mesh had to be repaired.

    See Also
    --------
    build : Build the anatomy of a knee.
    trace : Compute path lengths only.

    Examples
    --------
    >>> import pssf
    >>> protocol = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(pssf.Knee(), protocol, rng=7, engine="scanline")
    >>> radiograph.pixels.shape, radiograph.pixels.dtype, radiograph.truth.grade
    ((64, 64), dtype('uint16'), 0)
    """
    if isinstance(protocol, str | PathLike):
        protocol = load_protocol(protocol)
    seed = resolve_seed(rng)
    _require_arguments(knee, protocol, keep, engine, workers)
    clock = Timer()
    subject = _build_subject(knee, protocol, workers)
    # The radiograph stores the final beam angle instead of the positioning rule that determines it.
    protocol = subject.aim_beam(protocol) if isinstance(subject, BuiltKnee) else protocol
    technique = resolve_technique(protocol)
    scene = _resolve_scene(subject, protocol)
    clock.lap("anatomy")
    require_materials(scene, technique)  # Materials are checked before the slow ray casting.
    chain = StageContext(technique=technique, engine=engine, seed=seed, keep=frozenset(keep), workers=workers)
    image, audit = _trace_scene(scene, chain, paths)
    clock.lap("rays")
    faults = [*find_material_faults(scene, technique), *(outside := find_field_faults(image.path_mm, technique))]
    if isinstance(subject, Scene):
        faults += _check_overlaps(scene, protocol)
    with ThreadPoolExecutor(1) as aside:
        known = aside.submit(_describe_subject, subject, protocol, keep)
        seconds = run_stages(image, chain)
    wanted = [*keep, "scatter_error"] if "scatter" in keep else list(keep)
    assert image.pixels is not None
    made = Radiograph(
        pixels=image.pixels,
        protocol=protocol,
        seed=seed,
        **known.result(),
        engine=engine,
        audit=audit.counts(),
        versions=collect_versions(),
        kept={name: image.kept[name] for name in wanted if name in image.kept},
        seconds={**clock.seconds, **seconds},
    )
    faults += find_saturation_faults(made.pixels, scene, technique)
    if not outside:
        faults += find_landmark_faults((made.truth,) if made.truth else made.truths, technique)
    for notice in [*_find_kernel_warnings(technique), *map(ImageNotice, faults)]:
        warnings.warn(notice, stacklevel=4)
    return made


def _resolve_scene(subject: BuiltKnee | BuiltPair | Scene, protocol: Protocol) -> Scene:
    """Apply the overlap rule of a scene, or check that the legs of a subject are in front of the detector."""
    if isinstance(subject, Scene):
        return resolve_overlaps(subject)
    require_detector_clearance(subject.scene, protocol)
    return subject.scene


def _check_overlaps(scene: Scene, protocol: Protocol) -> list[str]:
    """Return a warning about each overlap of a scene with the rule "warn"; raise InputError with the rule "refuse"."""
    if scene.overlap not in ("warn", "refuse"):
        return []
    faults = find_overlap_faults(scene, textureless=protocol.texture == "none")
    if faults and scene.overlap == "refuse":
        raise InputError(f"surfaces of a scene with overlap = 'refuse' must not overlap, got: {'; '.join(faults)}")
    return [
        f"{fault}, where the paths in both are counted; Scene(..., overlap='first') gives an overlap to the body that "
        "is listed first, and overlap='sum' turns this warning off"
        for fault in faults
    ]


def _find_kernel_warnings(technique: Technique) -> list[KernelNotice]:
    """Return warnings if the scatter kernel is used outside its valid range."""
    protocol, kernel = technique.protocol, technique.kernel
    if protocol.scatter != "kernel":
        return []
    if protocol.projection == "axial":
        return [KernelNotice(_AXIAL_KERNEL_WARNING)]
    notices = []
    if not protocol.has_plain_beam or not kernel.is_checked_for(protocol.tube_kv, protocol.filtration_mm_al):
        low_kv, high_kv = kernel.checked_kv
        least_mm, most_mm = kernel.checked_mm_al
        notices.append(
            KernelNotice(
                f"scatter = 'kernel' is valid for tube spectra of {low_kv:g} to {high_kv:g} kV behind {least_mm:g} to "
                f"{most_mm:g} mm Al without other filters, and can be wrong by a factor of 2 for this beam; use "
                "scatter = 'monte_carlo', which is valid for every beam"
            )
        )
    width_mm, height_mm = (2 * half for half in field_half_size_mm(technique))
    off = kernel.find_small_field_bias(width_mm, height_mm)
    if off is not None:
        least = " x ".join(f"{side:g}" for side in kernel.full_field_mm)
        notices.append(
            KernelNotice(
                f"scatter = 'kernel' is not fitted to fields below {least} mm (got {width_mm:.0f} x {height_mm:.0f} "
                f"mm) and gives {off.low:g} to {off.high:g} times the scatter of the Monte Carlo simulation at the "
                "joint; use scatter = 'monte_carlo', which is valid for every field"
            )
        )
    return notices


def _require_arguments(knee: Subject, protocol: Protocol, keep: Collection[str], engine: str, workers: int) -> None:
    """Raise InputError if arguments of `simulate` are invalid or inconsistent."""
    require_choice("engine", engine, ENGINES)
    require_workers(workers)
    if isinstance(keep, str) or not isinstance(keep, Collection):
        raise InputError(f"keep must be a list with names from {', '.join(KEEPABLE_MAPS)}, got {keep!r}")
    for name in keep:
        require_choice("keep", name, KEEPABLE_MAPS)
    if "masks" in keep and isinstance(knee, Scene):
        raise InputError("keep must not contain masks for a Scene, got keep = masks: masks need a Knee")
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol must be a Protocol, for example from load_protocol, got {protocol!r}")
    pair = isinstance(knee, tuple) and len(knee) == 2
    knees: Any = knee.knees if isinstance(knee, BuiltPair) else knee if pair else (knee,)
    for one in knees:
        _require_knee(one, protocol)
    if isinstance(knee, Knee | BuiltKnee) and protocol.knee_distance_mm:
        raise InputError(
            f"knee_distance_mm must be 0 for one knee, got {protocol.knee_distance_mm:g} mm: "
            "for both knees, call simulate((right, left), ...)"
        )
    if isinstance(knee, BuiltPair) and knee.knee_distance_mm != protocol.knee_distance_mm:
        raise InputError(
            f"knee_distance_mm must be {knee.knee_distance_mm:g} mm, as in build, got {protocol.knee_distance_mm:g} mm"
        )


def _require_knee(knee: object, protocol: Protocol) -> None:
    """Raise InputError if a subject is neither a knee nor a scene, or is not built in the posture of the protocol."""
    if not isinstance(knee, Knee | BuiltKnee | Scene):
        raise InputError(f"knee must be a Knee, a BuiltKnee, a (right, left) pair of them, or a Scene, got {knee!r}")
    if isinstance(knee, BuiltKnee) and knee.assembly.posture != protocol.posture:
        raise InputError(
            f"knee must be built in the protocol posture, {protocol.posture}, got {knee.assembly.posture}: "
            "call build(knee, protocol)"
        )


def _build_subject(knee: Subject, protocol: Protocol, workers: int) -> BuiltKnee | BuiltPair | Scene:
    """Build the anatomy of a knee or of both knees; other subjects are returned unchanged."""
    if not isinstance(knee, Knee | tuple):
        return knee
    with ThreadPoolExecutor(1) as background:
        if isinstance(knee, tuple):
            return build_pair(*knee, protocol)
        if workers > 1 and protocol.texture != "none":
            background.submit(make_texture, knee)
        return build(knee, protocol)


def _trace_scene(scene: Scene, context: StageContext, paths: Paths | None) -> tuple[LatentImage, Audit]:
    """Compute the path lengths or use the specified ones; return the initial latent image and the ray counts.

    Path lengths are stored as sparse maps unless the radiograph keeps them.
    """
    protocol = context.technique.protocol
    if paths is not None and protocol.subpixels != 1:
        raise InputError(f"subpixels must be 1 with paths, got {protocol.subpixels}: paths contain one ray per pixel")
    if paths is None and "path_mm" not in context.keep:
        path_mm, audit = trace_sparse(scene, protocol, engine=context.engine, workers=context.workers)
        return LatentImage(path_mm=path_mm, scene=scene), audit
    if paths is None:
        paths = trace(scene, protocol, engine=context.engine, workers=context.workers)
    _require_matching_paths(paths, scene, protocol)
    return LatentImage(path_mm=paths.path_mm, scene=scene, kept={"path_mm": paths.path_mm}), paths.audit


def _describe_subject(
    subject: BuiltKnee | BuiltPair | Scene, protocol: Protocol, keep: Collection[str]
) -> dict[str, Any]:
    """Collect the fields of a radiograph that describe the imaged object: knee or scene, labels and surgery."""
    masked = "masks" in keep
    if isinstance(subject, BuiltKnee):
        truth = subject.truth(protocol)
        truth = _add_masks(truth, subject.mask_meshes(), protocol) if masked else truth
        return {"knee": subject.knee, "truth": truth, "surgery": subject.surgery_table()}
    if isinstance(subject, BuiltPair):
        truths = subject.truths(protocol)
        if masked:
            pairs = zip(truths, subject.mask_meshes(), strict=True)
            truths = tuple(_add_masks(truth, solids, protocol) for truth, solids in pairs)
        surgery = tuple(step for built in subject.knees for step in built.surgery_table(f"{built.knee.side}_"))
        return {"knees": tuple(built.knee for built in subject.knees), "truths": truths, "surgery": surgery}
    return {"scene": subject.table()}


def _add_masks(truth: Truth, solids: dict[str, Mesh], protocol: Protocol) -> Truth:
    """Add the silhouettes of bones, osteophytes, cysts and implants to the labels of a knee."""
    view = resolve_view(protocol)
    return replace(truth, masks={name: compute_face_silhouette(mesh, view) for name, mesh in solids.items()})


def _require_matching_paths(paths: Paths, scene: Scene, protocol: Protocol) -> None:
    """Raise InputError if path lengths do not belong to the scene and to the view of the protocol."""
    if not isinstance(paths, Paths):
        raise InputError(f"paths must be a Paths object from trace, got {type(paths).__name__}")
    if paths.scene is not scene:
        raise InputError(f"paths must belong to the simulated scene {scene!r}, got scene {paths.scene!r}")
    if paths.view != resolve_view(protocol):
        raise InputError(f"paths must have the view of the protocol, {resolve_view(protocol)}, got {paths.view}")
    if paths.texture != protocol.texture:
        raise InputError(f"paths must have the texture of the protocol, {protocol.texture!r}, got {paths.texture!r}")


@cache
def collect_versions() -> dict[str, str]:
    """Collect the versions of the package and of the libraries that affect the pixels.

    Returns
    -------
    dict of str to str
        Version of each package, keyed by package name.
    """
    return {name: version(name) for name in PIXEL_LIBRARIES}
