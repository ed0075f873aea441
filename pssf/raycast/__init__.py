"""Ray casting: path lengths in each material, silhouettes, and checks of a scene.

`trace` computes path lengths as arrays of shape (rows, cols). `trace_sparse` computes the same path lengths without
storing the air beside the object. `check` lists all faults of a scene. `compute_silhouette` finds the pixels that a
mesh covers.

Modules:

- `path_lengths`: path lengths and ray counts, as returned by `trace`.
- `scene_check`: the function `check` and its report.
- `surface_overlaps`: detection of surfaces with a wrong outside material, and of meshes that overlap themselves.
- `overlap_priority`: cuts of overlapping bodies by the rule of a scene.
- `density_mismatch`: detection of surfaces whose outside density is not the density of the surrounding material.
- `negative_paths`: detection of negative path lengths and their causes.
- `detector_clearance`: distance between the leg and the detector.
- `engines`: projection of surfaces, ray casting (Embree, scanline) and integrals along rays.
"""

import reprlib
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import (
    Array,
    InputError,
    require_choice,
    require_workers,
)
from ..core.keyword_arguments import check_keywords
from ..geometry.density import Density
from ..geometry.mesh import Mesh
from ..geometry.mesh_repair import Solid, require_usable_solid
from ..geometry.scene import (
    HasScene,
    Scene,
    Surface,
    require_traceable,
    resolve_scene,
)
from ..geometry.view import View, resolve_view
from ..model.protocol import Protocol
from .density_mismatch import require_matching_densities
from .engines import scanline
from .engines.crossings import (
    Crossings,
    chord_fractions,
    integrate_along_rays,
    merge_crossings,
)
from .engines.pixel_rays import add_box_path, convert_to_mm
from .engines.projected_surface import (
    BAND_ROWS,
    ProjectedSurface,
    make_ray_frame,
    project_surface,
)
from .engines.sparse_map import SparseMap
from .negative_paths import require_nonnegative_paths
from .overlap_priority import resolve_overlaps
from .path_lengths import Audit, Paths, sum_audits
from .scene_check import Report, check, find_overlap_faults

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "Audit",
    "Paths",
    "Report",
    "check",
    "compute_face_silhouette",
    "compute_scene_silhouette",
    "compute_silhouette",
    "find_overlap_faults",
    "require_nonnegative_paths",
    "resolve_overlaps",
    "trace",
    "trace_sparse",
]

# Names of the ray casting engines.
ENGINES = ("embree", "scanline")
# Floating-point types of path lengths.
PRECISIONS = ("float32", "float64")
# Path length map (rows, cols) of each material.
Sums = dict[str, NDArray[Any]]
# Each key is a material name and the id() of the density object. Each value is a tuple of the density, the crossings of
# the surfaces with this density (with signs), and the names of these surfaces.
_DensityGroups = dict[tuple[str, int], tuple[Density, list[tuple[Crossings, int]], list[str]]]


@check_keywords()
def trace(
    scene: Scene | HasScene,
    protocol: Protocol | View,
    *,
    engine: str = "embree",
    materials: Iterable[str] | None = None,
    precision: str = "float32",
    texture: bool = True,
    workers: int = 2,
) -> Paths:
    """Compute the path length in each material along every ray from the source to a pixel centre.

    Parameters
    ----------
    scene : Scene or object with a scene
        Closed surfaces, or an object with the attribute `scene`, such as the result of ``build(knee)``.
    protocol : Protocol or View
        Source and detector. A protocol with ``texture="none"`` also disables bone texture.
    engine : {"embree", "scanline"}, default "embree"
        Ray casting engine. Embree casts rays in float32 and recomputes unreliable rays; the scanline engine projects
        triangles in float64.
    materials : iterable of str, optional
        Materials to return; by default all except the ambient material. The path in the ambient material is measured
        only inside the bounding box of the scene.
    precision : {"float32", "float64"}, default "float32"
        Floating-point type of the path lengths. The rounding error of float32 is 4e-6 mm for a path of 100 mm.
    texture : bool, default True
        If True, the density of trabecular bone varies in space. If False, the density of every material is constant.
    workers : int, default 2
        Number of threads, from 1 to 256; it does not change the result.

    Returns
    -------
    Paths
        Path lengths in mm, as a map (rows, cols) of each material, and counts of cast and recomputed rays.

    Raises
    ------
    InputError
        If engine, material or precision is unknown, or the scene cannot be traced (see `check`). The error is also
        raised if a path length is below -0.05 mm, or a density function does not return one finite number per segment.

    Warns
    -----
    MeshNotice
        If a mesh had to be repaired.

    See Also
    --------
    check : List what is wrong with a scene.

    Notes
    -----
    Each crossing of a ray with a closed surface contributes sign x F(t), where t is the distance along the ray. The
    sign is + where the ray leaves the surface and - where it enters. F(t) is t for a constant density. For a varying
    density, F(t) is the integral of the density from the source to t. The path in a material is the sum over surfaces
    with the material inside, minus the sum over surfaces with the material outside. Sums are computed in float64.

    Parts of a surface behind the source or behind the detector are ignored. Where a mesh overlaps itself, the path
    length is multiplied by the winding number.

    Examples
    --------
    >>> import pssf, trimesh
    >>> ball = pssf.Surface(trimesh.creation.icosphere(radius=20.0), inside="muscle", outside="air", name="ball")
    >>> paths = pssf.trace(pssf.Scene([ball]), pssf.load_protocol("reference").resample(64))
    >>> {material: round(float(path_mm.max()), 1) for material, path_mm in paths.path_mm.items()}
    {'muscle': 39.5}
    >>> paths.audit.unrepaired
    0
    """
    scene, view = resolve_overlaps(resolve_scene(scene)), resolve_view(protocol)
    require_choice("precision", precision, PRECISIONS)
    require_choice("texture", texture, (True, False))
    path_mm: Sums = {m: np.zeros((view.rows, view.cols), precision) for m in _select_materials(scene, materials)}
    smooth = not texture or _has_no_texture(protocol)
    audit = _fill_path_maps(scene, view, path_mm, engine, smooth, workers)
    return Paths(path_mm=path_mm, audit=audit, view=view, texture="none" if smooth else "trabecular", scene=scene)


def trace_sparse(
    scene: Scene, protocol: Protocol | View, *, engine: str = "embree", texture: bool = True, workers: int = 2
) -> tuple[dict[str, SparseMap], Audit]:
    """Compute the path lengths of `trace`, stored without the air beside the object.

    Parameters
    ----------
    scene : Scene
        Closed surfaces.
    protocol : Protocol or View
        Source and detector. A protocol with ``texture="none"`` also disables bone texture.
    engine : {"embree", "scanline"}, default "embree"
        Ray casting engine.
    texture : bool, default True
        If True, the density of trabecular bone varies in space. If False, the density of every material is constant.
    workers : int, default 2
        Number of threads, from 1 to 256; it does not change the result.

    Returns
    -------
    path_mm : dict of str to SparseMap
        Path lengths in mm, as a map (rows, cols) of each material except the ambient material.
    audit : Audit
        Counts of cast and recomputed rays.

    Raises
    ------
    InputError
        For the same errors as in `trace`.

    Warns
    -----
    MeshNotice
        If a mesh had to be repaired.
    """
    scene, view = resolve_overlaps(scene), resolve_view(protocol)
    path_mm = {material: SparseMap((view.rows, view.cols)) for material in _select_materials(scene, None)}
    return path_mm, _fill_path_maps(scene, view, path_mm, engine, not texture or _has_no_texture(protocol), workers)


def _has_no_texture(protocol: Protocol | View) -> bool:
    """Report whether a protocol disables the texture of trabecular bone."""
    return isinstance(protocol, Protocol) and protocol.texture == "none"


def _fill_path_maps(
    scene: Scene, view: View, path_mm: Mapping[str, Any], engine: str, textureless: bool, workers: int
) -> Audit:
    """Fill the path length maps (rows, cols) of the requested materials, in mm; return the ray counts."""
    require_choice("engine", engine, ENGINES)
    require_workers(workers)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda surface: surface.solid, scene.surfaces))
        require_traceable(scene)
        if not textureless:
            require_matching_densities(scene)
        asked = [surface for surface in scene.surfaces if {surface.inside, surface.outside} & path_mm.keys()]
        layers = _build_layers(asked, view, engine, textureless, pool)
        audit = sum_audits(pool.map(partial(_trace_band, scene, view, layers, path_mm), range(0, view.rows, BAND_ROWS)))
    require_nonnegative_paths(path_mm, scene, view)
    return audit


def _select_materials(scene: Scene, materials: Iterable[str] | None) -> list[str]:
    """Return the requested materials in order, without duplicates; by default all except the ambient material."""
    if materials is None:
        return list(scene.materials[1:])
    if isinstance(materials, str) or not isinstance(materials, Iterable):
        raise InputError(
            f"materials must be a list with names from {', '.join(scene.materials)}, got {reprlib.repr(materials)}"
        )
    listed = list(materials)
    for material in listed:
        require_choice("material", material, scene.materials)
    return list(dict.fromkeys(listed))


def compute_silhouette(mesh: "trimesh.Trimesh | Mesh", protocol: Protocol | View) -> NDArray[np.bool_]:
    """Find the pixels that a closed mesh covers.

    Parameters
    ----------
    mesh : trimesh.Trimesh or Mesh
        Closed mesh in mm. A mesh without faces, such as an osteophyte inside the bone, covers no pixel.
    protocol : Protocol or View
        Source and detector.

    Returns
    -------
    (rows, cols) bool array
        True where a ray crosses the mesh.

    Raises
    ------
    InputError
        If the mesh does not bound a solid, or `protocol` is neither a Protocol nor a View.
    """
    view = resolve_view(protocol)
    if not len(mesh.faces):
        return np.zeros((view.rows, view.cols), np.bool_)
    solid = Surface(mesh, "solid", "air").solid
    require_usable_solid(solid)
    return _project_silhouette(solid, view)


def compute_face_silhouette(mesh: Mesh, view: View) -> NDArray[np.bool_]:
    """Find the pixels whose rays cross a face of a mesh, without checking that the mesh is closed.

    Parameters
    ----------
    mesh : Mesh
        Valid triangles in mm, such as the faces of an osteophyte.
    view : View
        Source and detector.

    Returns
    -------
    (rows, cols) bool array
        True where a ray crosses a face.
    """
    numbers = np.arange(len(mesh.vertices))
    solid = Solid(points=mesh.vertices, faces=np.asarray(mesh.faces, np.int32), source_vertices=numbers)
    return _project_silhouette(solid, view)


def _project_silhouette(solid: Solid, view: View) -> NDArray[np.bool_]:
    """Find the pixels (rows, cols) whose rays cross a surface."""
    silhouette = np.zeros((view.rows, view.cols), np.bool_)
    if len(solid.faces):
        _add_silhouette(silhouette, project_surface(solid, view))
    return silhouette


def compute_scene_silhouette(scene: Scene, view: View) -> NDArray[np.bool_]:
    """Find the pixels that are covered by any surface in contact with the ambient material.

    Parameters
    ----------
    scene : Scene
        Closed surfaces; only those whose outside material is the ambient material are used.
    view : View
        Source and detector.

    Returns
    -------
    (rows, cols) bool array
        True where the ray to the pixel crosses a surface in contact with the ambient material.
    """
    seen = np.zeros((view.rows, view.cols), np.bool_)
    for surface in scene.surfaces:
        if surface.outside == scene.ambient:
            _add_silhouette(seen, project_surface(surface.solid, view))
    return seen


def _add_silhouette(silhouette: NDArray[np.bool_], sheet: ProjectedSurface) -> None:
    """Mark the pixels of a silhouette (rows, cols) whose rays cross a surface."""
    columns = slice(*sheet.cols)
    for first in range(0, len(silhouette), BAND_ROWS):
        top, bottom = max(first, sheet.rows[0]), min(first + BAND_ROWS, sheet.rows[1])
        if top < bottom:
            silhouette[top:bottom, columns] |= scanline.count_crossings(sheet, top, bottom) > 0


@dataclass(frozen=True)
class _Layer:
    """Surface with its inside and outside densities, its projection and its ray caster."""

    surface: Surface
    densities: tuple[Density | None, Density | None]
    sheet: ProjectedSurface
    caster: Any


def _build_layers(surfaces: list[Surface], view: View, engine: str, textureless: bool, pool: Executor) -> list[_Layer]:
    """Build one layer for each surface that covers a pixel.

    A surface that passes through the source raises InputError.
    """
    # Embree is imported only if it is used, because the scanline engine does not need it.
    if engine == "embree":
        from .engines.embree import Caster
    else:
        Caster = scanline.Caster  # type: ignore[assignment, misc]

    def layer(surface: Surface) -> _Layer | None:
        sheet = project_surface(surface.solid, view)
        around = _source_winding(sheet, view, surface.name)
        covers = sheet.rows[0] < sheet.rows[1] and sheet.cols[0] < sheet.cols[1]
        densities = (None, None) if textureless else (surface.inside_density, surface.outside_density)
        return _Layer(surface, densities, sheet, Caster(sheet, around)) if covers else None

    return [seen for seen in pool.map(layer, surfaces) if seen is not None]


def _source_winding(sheet: ProjectedSurface, view: View, name: str) -> int:
    """Compute the winding number of a surface around the source: the sum of the crossing signs of every ray."""
    if not sheet.is_clipped:
        return 0
    bands = [
        scanline.sum_windings(sheet, max(first, sheet.rows[0]), min(first + BAND_ROWS, sheet.rows[1]))
        for first in range(sheet.rows[0] // BAND_ROWS * BAND_ROWS, sheet.rows[1], BAND_ROWS)
    ]
    sums = {float(edge(band)) for band in bands if band.size for edge in (np.min, np.max)}
    if (sheet.rows, sheet.cols) != ((0, view.rows), (0, view.cols)):
        sums.add(0.0)
    if len(sums) > 1:
        raise InputError(
            f"{name}: source_mm must be inside or outside the surface, got {view.source_mm} mm on the surface"
        )
    return int(sums.pop())


def _trace_band(scene: Scene, view: View, layers: list[_Layer], path_mm: Mapping[str, Any], first: int) -> Audit:
    """Fill one band of rows in the path length map of every material; return the ray counts of the band."""
    stop = min(first + BAND_ROWS, view.rows)
    sums = {material: np.zeros((stop - first, view.cols)) for material in path_mm}
    frame, touched, audits = make_ray_frame(view), {scene.ambient}, [Audit()]
    varying: _DensityGroups = {}
    for layer in layers:
        surface, sheet = layer.surface, layer.sheet
        top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
        if top >= bottom:
            continue
        chord, crossings, audit = _cast_layer(layer, top, bottom)
        audits.append(audit)
        for material, density, sign in zip((surface.inside, surface.outside), layer.densities, (+1, -1), strict=True):
            if material not in sums:
                continue
            touched.add(material)
            if density is not None and crossings is not None:
                _, parts, names = varying.setdefault((material, id(density)), (density, [], []))
                parts.append((crossings, sign))
                names.append(surface.name)
            else:
                _add_window(sums[material], chord, top - first, sheet.cols[0], sign)
    for (material, _), (density, parts, names) in varying.items():
        # Surfaces that share a density are merged before integration. Otherwise, segments inside both surfaces would be
        # integrated twice.
        whole = merge_crossings(parts)
        try:
            integral = integrate_along_rays(whole, frame, density)
        except InputError as error:
            raise InputError(f"{', '.join(names)}: density of {material}: {error}") from None
        _add_window(sums[material], integral, whole.window.row - first, whole.window.col, +1)
    if scene.ambient in sums:
        add_box_path(frame, scene.bounds_mm, first, sums[scene.ambient])
    for material in touched & sums.keys():
        path_mm[material][first:stop] = convert_to_mm(sums[material], frame, first)
    return sum_audits(audits)


def _add_window(sums: Array, lengths: Array, row: int, col: int, sign: int) -> None:
    """Add lengths (rows, cols) to a window of `sums`, or subtract the lengths if `sign` is negative."""
    part = sums[row : row + lengths.shape[0], col : col + lengths.shape[1]]
    (np.add if sign > 0 else np.subtract)(part, lengths, out=part)


def _cast_layer(layer: _Layer, top: int, bottom: int) -> tuple[Array, Crossings | None, Audit]:
    """Compute the chords inside a surface and count its rays; also return the crossings if the density varies."""
    if layer.densities == (None, None):
        chord, audit = layer.caster.trace_chords(top, bottom)
        return chord, None, audit
    crossings, audit = layer.caster.find_crossings(top, bottom)
    return chord_fractions(crossings), crossings, audit
