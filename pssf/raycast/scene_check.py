"""Check a scene for faults before a radiograph is simulated."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..core.keyword_arguments import check_keywords
from ..data.anatomy.tissue_table import DENSEST_GAS_G_PER_CM3, Tissue, load_tissues
from ..geometry.mesh_repair import Fault
from ..geometry.scene import (
    HasScene,
    Scene,
    Surface,
    resolve_scene,
)
from ..geometry.view import View, depth_fraction, resolve_view
from ..model.protocol import Protocol
from .density_mismatch import find_density_faults
from .engines.projected_surface import project_surface
from .engines.triangle_clipping import MIN_DEPTH_FRACTION
from .negative_paths import explain_negative_path, find_shortest_paths
from .overlap_priority import resolve_overlaps
from .path_lengths import OVERLAP_TOLERANCE_MM
from .surface_overlaps import find_contradictions, find_self_overlaps

# Number of sample rays along each side of a detector that covers the bounding box of the scene; assumed.
_SAMPLE_RAYS_PER_SIDE = 128
# Distance from the sample ray source to the centre of the scene, as a multiple of the scene size; assumed.
_SOURCE_DISTANCE_FACTOR = 7.3
# Problem text for a surface outside the field of view; the command-line interface identifies these faults by this text.
COVERS_NO_PIXEL = "covers no pixel"
# Final phrase in the problem text of faults that are counted in sample rays.
_SAMPLE_RAYS_LABEL = "number of sample rays affected"


@dataclass(frozen=True)
class Report:
    """Scene faults that `check` found.

    ``str(report)`` has one line per fault, or the text "no faults".

    Attributes
    ----------
    faults : tuple of Fault
        Faults in the order of `Scene.faults`, followed by warnings.
    """

    faults: tuple[Fault, ...]

    @property
    def ok(self) -> bool:
        """True if `trace` accepts the scene."""
        return not any(fault.outcome == "error" for fault in self.faults)

    def __str__(self) -> str:
        return "\n".join(f"{fault.outcome}: {fault}" for fault in self.faults) or "no faults"


@check_keywords()
def check(scene: Scene | HasScene, protocol: Protocol | View | None = None) -> Report:
    """Check a scene for faults, surface by surface.

    Parameters
    ----------
    scene : Scene or object with a scene
        Closed surfaces, or an object with the attribute `scene`, such as the result of ``build(knee)``.
    protocol : Protocol or View, optional
        Source and detector. If specified, path lengths are checked in this view. Surface parts behind the source,
        behind the detector or outside the field of view are reported. If None, path lengths are checked along 128 x 128
        rays through the scene.

    Returns
    -------
    Report
        Report of all faults; ``report.ok`` is True if `trace` accepts the scene.

    Raises
    ------
    InputError
        If `scene` is neither a Scene nor an object with the attribute `scene`, or `protocol` is neither a Protocol nor
        a View.

    See Also
    --------
    trace : Compute path lengths; it raises an error for the faults with outcome "error".

    Notes
    -----
    Each fault has one of three outcomes:

    - "error": `trace` raises InputError.
    - "repaired": `trace` repairs the mesh.
    - "warning": `trace` uses the scene unchanged. Edges with more than two faces and slightly negative path lengths
      cause warnings. Meshes that overlap themselves cause warnings, and so do surfaces whose outside material differs
      from the material that rays find around them.

    `check` does not look up material names. `simulate` raises an error for unknown materials before rays are cast.

    Examples
    --------
    >>> import pssf, trimesh
    >>> ball = pssf.Surface(trimesh.creation.icosphere(radius=20.0), inside="muscle", outside="air", name="ball")
    >>> report = pssf.check(pssf.Scene([ball]), pssf.load_protocol("reference").resample(64))
    >>> report.ok
    True
    >>> print(report)
    no faults
    """
    scene = resolve_overlaps(resolve_scene(scene))
    view = None if protocol is None else resolve_view(protocol)
    faults = list(scene.faults)
    smooth = isinstance(protocol, Protocol) and protocol.texture == "none"
    if not smooth:
        faults += find_density_faults(scene)
    if scene.surfaces and not any(fault.outcome == "error" for fault in faults):
        sample = _make_sample_view(scene.bounds_mm)
        for surface in scene.surfaces:
            faults += _find_nonmanifold_edges(surface)
        faults += [
            *_find_dense_ambient(scene, load_tissues()),
            *_find_overlaps(scene, sample, smooth),
            *_find_negative_paths(scene, view or sample),
        ]
        if view is not None:
            faults += [fault for surface in scene.surfaces for fault in _find_parts_out_of_view(surface, view)]
    return Report(tuple(faults))


def find_overlap_faults(scene: Scene, *, textureless: bool) -> list[str]:
    """Find surfaces whose outside material is wrong, such as those of overlapping bodies, along 128 x 128 rays.

    Parameters
    ----------
    scene : Scene
        Closed surfaces that `trace` accepts.
    textureless : bool
        If True, materials that differ only in density are not reported.

    Returns
    -------
    list of str
        One text per pair of surfaces, in the order of the longest affected ray segment.
    """
    if len(scene.surfaces) < 2:
        return []
    sample = _make_sample_view(scene.bounds_mm)
    wrong = [one for one in find_contradictions(scene, sample) if not (textureless and one.is_density_only)]
    pairs: dict[frozenset[str], float] = {}
    for one in wrong:
        pair = frozenset((one.surface, one.found_surface or scene.ambient))
        pairs[pair] = max(pairs.get(pair, 0.0), one.longest_mm)
    mutual = {(one.surface, one.found_surface) for one in wrong}
    texts = []
    for pair, longest_mm in sorted(pairs.items(), key=lambda item: -item[1]):
        first, *second = sorted(pair)
        names = f"{first} and {second[0]}" if second else first
        overlaps = bool(second) and (first, second[0]) in mutual and (second[0], first) in mutual
        what = "overlap" if overlaps else "have an outside material or a position that is wrong"
        texts.append(f"surfaces {names} {what}, over up to {longest_mm:.3g} mm of a ray")
    return texts


def _make_warning_fault(surface: str, what: str, count: int, first: tuple[object, ...], hint: str) -> Fault:
    """Make a fault with the outcome "warning", which does not stop `trace`."""
    return Fault(surface=surface, problem=what, count=count, first_items=first, outcome="warning", hint=hint)


def _find_nonmanifold_edges(surface: Surface) -> list[Fault]:
    """Find edges of a mesh that have more than two faces."""
    faces = surface.solid.faces.astype(np.int64)
    start, end = (faces[:, order].ravel() for order in ([0, 1, 2], [1, 2, 0]))
    keys = np.minimum(start, end) << 32 | np.maximum(start, end)
    edges, degree = np.unique(keys, return_counts=True)
    crowded = edges[degree > 2]
    if not len(crowded):
        return []
    number = surface.solid.source_vertices
    first = tuple(f"{number[edge >> 32]}-{number[edge & 0xFFFFFFFF]}" for edge in crowded[:3])
    return [
        _make_warning_fault(
            surface.name, "edges with more than two faces", len(crowded), first, "path lengths are still correct"
        )
    ]


def _find_dense_ambient(scene: Scene, tissue_table: Mapping[str, Tissue]) -> list[Fault]:
    """Warn of an ambient material that is denser than a gas, if the name of the material states its density."""
    tissue, _, given = tissue_table.get(scene.ambient), *scene.ambient.partition("@")[1:]
    try:
        # The tissue table has no density for a mixture of tissues; a density of 1 is assumed, because any mixture is
        # denser than gas.
        density = float(given) if tissue is None else tissue.density or 1.0
    except ValueError:
        return []
    if density <= DENSEST_GAS_G_PER_CM3:
        return []
    hint = (
        f"simulate would raise an error for this scene; enclose the scene in a closed surface of {scene.ambient} that "
        "is surrounded by air"
    )
    return [_make_warning_fault("ambient", f"{scene.ambient} outside all surfaces does not attenuate", 0, (), hint)]


def _find_overlaps(scene: Scene, sample: View, textureless: bool) -> list[Fault]:
    """Find meshes that overlap themselves, and surfaces with a wrong outside material, along sample rays.

    If `textureless` is True, materials that differ only in density are not reported.
    """
    faults = []
    for fold in find_self_overlaps(scene, sample):
        what = (
            f"mesh overlaps itself or is partly inside out, over up to {fold.longest_mm:.3g} mm of a ray; "
            f"{_SAMPLE_RAYS_LABEL}"
        )
        name, hint = (
            scene.surfaces[fold.surface].name,
            "the path length is multiplied by the winding number of the mesh",
        )
        faults.append(_make_warning_fault(name, what, fold.rays, (), hint))
    contrary = [one for one in find_contradictions(scene, sample) if not (textureless and one.is_density_only)]
    pairs = {(one.surface, one.found_surface) for one in contrary}
    for one in contrary:
        mutual = (one.found_surface, one.surface) in pairs
        hint = (
            f"{one.surface} and {one.found_surface} overlap"
            if mutual
            else "outside material or surface position is wrong"
        )
        faults.append(_make_warning_fault(one.surface, f"{one}; {_SAMPLE_RAYS_LABEL}", one.rays, (), hint))
    return faults


def _find_negative_paths(scene: Scene, view: View) -> list[Fault]:
    """Find materials with negative path lengths, within the tolerance or beyond the tolerance."""
    faults = []
    for material, least in find_shortest_paths(scene, view).items():
        if least.min_path_mm < -OVERLAP_TOLERANCE_MM:
            what = f"path length is negative, down to {least.min_path_mm:.4g} mm; number of rays affected"
            hint = (
                f"{explain_negative_path(scene, view, material, least.row, least.col)}; "
                f"the path length must be {-OVERLAP_TOLERANCE_MM:g} mm or more"
            )
            faults.append(replace(_make_warning_fault(material, what, least.negative_rays, (), hint), outcome="error"))
        elif least.negative_rays:
            what = f"path length is slightly negative, down to {least.min_path_mm:.4g} mm; number of rays affected"
            hint = "mesh folds are the usual cause; trace uses the mesh unchanged"
            faults.append(_make_warning_fault(material, what, least.negative_rays, (), hint))
    return faults


def _make_sample_view(bounds_mm: Array) -> View:
    """Make a view with nearly parallel, oblique rays that covers the bounding box of a scene."""
    centre, size = bounds_mm.mean(axis=0), float(np.ptp(bounds_mm, axis=0).max())
    source = centre + size * np.array([0.0137, -_SOURCE_DISTANCE_FACTOR, 0.0173])
    magnified = (_SOURCE_DISTANCE_FACTOR + 1) / (_SOURCE_DISTANCE_FACTOR - 0.5)
    return View(
        source_mm=(float(source[0]), float(source[1]), float(source[2])),
        centre_mm=(float(centre[0]), float(centre[1] + size), float(centre[2])),
        rows=_SAMPLE_RAYS_PER_SIDE,
        cols=_SAMPLE_RAYS_PER_SIDE,
        pixel_mm=1.05 * magnified * size / _SAMPLE_RAYS_PER_SIDE,
    )


def _find_parts_out_of_view(surface: Surface, view: View) -> list[Fault]:
    """Find parts of a surface that no ray of a view can cross."""
    depth = depth_fraction(surface.solid.points, view)
    sheet = project_surface(surface.solid, view)
    faults = []
    for what, count in (
        ("vertices behind the source", int((depth < MIN_DEPTH_FRACTION).sum())),
        ("vertices behind the detector", int((depth > 1).sum())),
    ):
        if count:
            faults.append(_make_warning_fault(surface.name, what, count, (), "no ray crosses them"))
    if sheet.rows[0] >= sheet.rows[1] or sheet.cols[0] >= sheet.cols[1]:
        faults.append(_make_warning_fault(surface.name, COVERS_NO_PIXEL, 0, (), "surface is not in the image"))
    return faults
