"""raycast.trace    scene, protocol  -> path lengths per material, (rows, cols), and an audit of the rays
raycast.trace_strips  the same, held in strips: what a radiograph is made of
raycast.shadow   mesh, protocol   -> where it is seen
raycast.check    scene            -> what is wrong with its meshes and what they say of each other

paths      what comes back
strips     the same without the air beside the object
overlaps   where surfaces contradict each other or themselves
density_mismatch  where they do not name the density that surrounds them
negative   paths of less than nothing: why, and which are refused
sheets     surfaces as a detector sees them
clip       cut off in front of the source
rays       their lengths, and where they meet a box
crossings  in order along each ray; integrals of a density between them
scanline   engine: triangles projected and accumulated in float64
embree     engine: rays cast hit by hit, audited, repaired by scanline
casting    rays under way from hit to hit
spread     what a ray met, taken from one beside it
"""

import reprlib
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_choice, require_workers
from ..core.keywords import keywords
from ..geometry.density import Density
from ..geometry.mesh import Mesh
from ..geometry.repair import require_sound
from ..geometry.scene import HasScene, Scene, Surface, require_traceable, scene_of
from ..geometry.view import View, view_of
from ..model.protocol import Protocol
from . import scanline
from .check import Report, check
from .crossings import Crossings, chords, integrals, joined
from .density_mismatch import require_densities
from .negative import require_paths
from .paths import Audit, Paths, total
from .rays import add_box, to_mm
from .sheets import BAND_ROWS, Sheet, frame_of, sheet_of
from .strips import Strips

if TYPE_CHECKING:
    import trimesh

__all__ = ["Audit", "Paths", "Report", "check", "require_paths", "scene_shadow", "shadow", "trace", "trace_strips"]

ENGINES = ("embree", "scanline")
PRECISIONS = ("float32", "float64")
Sums = dict[str, NDArray[Any]]
# Material and identity of a density -> the density, the crossings of the surfaces that bound it, and their names.
_Varying = dict[tuple[str, int], tuple[Density, list[tuple[Crossings, int]], list[str]]]


@keywords()
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
    """Path length in each material along every ray from the source to a pixel centre.

    A closed surface that a ray crosses contributes sign x F(t) at each crossing, + on leaving and - on entering, where
    F(t) = t, or the integral of the surface's density up to t; the path in a material is the sum over surfaces with it
    inside minus the sum over those with it outside, in float64. What is behind the source or the detector is not on the
    way. Where a mesh overlaps itself, path counts as often as the mesh goes around it.

    scene      surfaces, or what carries them, as `build(knee)` gives it
    materials  those wanted; by default all but the ambient one, whose path is counted inside the box around the scene
    precision  of what comes back: "float32" (4e-6 mm in 100 mm) or "float64"
    texture    False takes every material at its own density, as a protocol without texture does
    workers    threads; they do not change the result
    returns    path_mm (rows, cols) per material, and the audit
    raises     InputError for an unknown engine, material or precision, a scene that has no right answer (see `check`),
               a path of less than nothing, a density that does not give one finite number a segment
    warns      MeshNotice for a mesh that had to be mended
    """
    scene, view = scene_of(scene), view_of(protocol)
    require_choice("precision", precision, PRECISIONS)
    require_choice("texture", texture, (True, False))
    path_mm: Sums = {m: np.zeros((view.rows, view.cols), precision) for m in _wanted(scene, materials)}
    smooth = not texture or _is_smooth(protocol)
    audit = _filled(scene, view, path_mm, engine, smooth, workers)
    return Paths(path_mm=path_mm, audit=audit, view=view, texture="none" if smooth else "trabecular", scene=scene)


def trace_strips(
    scene: Scene, protocol: Protocol | View, *, engine: str = "embree", texture: bool = True, workers: int = 2
) -> tuple[dict[str, Strips], Audit]:
    """Path lengths as `trace` gives them, held without the air beside the object, and the audit of the rays.

    returns  material -> (rows, cols)
    raises   InputError, warns MeshNotice as `trace`
    """
    view = view_of(protocol)
    path_mm = {material: Strips((view.rows, view.cols)) for material in _wanted(scene, None)}
    return path_mm, _filled(scene, view, path_mm, engine, not texture or _is_smooth(protocol), workers)


def _is_smooth(protocol: Protocol | View) -> bool:
    return isinstance(protocol, Protocol) and protocol.texture == "none"


def _filled(scene: Scene, view: View, path_mm: Mapping[str, Any], engine: str, smooth: bool, workers: int) -> Audit:
    """Fill the maps (rows, cols), mm, of the materials that are wanted; returns the audit of all rays."""
    require_choice("engine", engine, ENGINES)
    require_workers(workers)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda surface: surface.solid, scene.surfaces))
        require_traceable(scene)
        if not smooth:
            require_densities(scene)
        asked = [surface for surface in scene.surfaces if {surface.inside, surface.outside} & path_mm.keys()]
        layers = _layers(asked, view, engine, smooth, pool)
        audit = total(pool.map(partial(_band, scene, view, layers, path_mm), range(0, view.rows, BAND_ROWS)))
    require_paths(path_mm, scene, view)
    return audit


def _wanted(scene: Scene, materials: Iterable[str] | None) -> list[str]:
    """Materials asked for, each once and in order."""
    if materials is None:
        return list(scene.materials[1:])
    if isinstance(materials, str) or not isinstance(materials, Iterable):
        raise InputError(f"materials = {reprlib.repr(materials)}; allowed: a list of {', '.join(scene.materials)}")
    listed = list(materials)
    for material in listed:
        require_choice("material", material, scene.materials)
    return list(dict.fromkeys(listed))


def shadow(mesh: "trimesh.Trimesh | Mesh", protocol: Protocol | View) -> NDArray[np.bool_]:
    """(rows, cols)  where a closed mesh is seen; nowhere if it has no faces, as an osteophyte that bone has swallowed

    raises  InputError for a mesh that bounds no solid, or no protocol
    """
    view = view_of(protocol)
    seen = np.zeros((view.rows, view.cols), np.bool_)
    if not len(mesh.faces):
        return seen
    solid = Surface(mesh, "solid", "air").solid
    require_sound(solid)
    _add_shadow(seen, sheet_of(solid, view))
    return seen


def scene_shadow(scene: Scene, view: View) -> NDArray[np.bool_]:
    """(rows, cols)  where any of a scene is seen that the ambient material surrounds"""
    seen = np.zeros((view.rows, view.cols), np.bool_)
    for surface in scene.surfaces:
        if surface.outside == scene.ambient:
            _add_shadow(seen, sheet_of(surface.solid, view))
    return seen


def _add_shadow(seen: NDArray[np.bool_], sheet: Sheet) -> None:
    """Mark the pixels (rows, cols) that see a surface."""
    columns = slice(*sheet.cols)
    for first in range(0, len(seen), BAND_ROWS):
        top, bottom = max(first, sheet.rows[0]), min(first + BAND_ROWS, sheet.rows[1])
        if top < bottom:
            seen[top:bottom, columns] |= scanline.counts(sheet, top, bottom) > 0


@dataclass(frozen=True)
class _Layer:
    """A surface, the densities inside and outside it, how a detector sees it, and what casts its rays."""

    surface: Surface
    densities: tuple[Density | None, Density | None]
    sheet: Sheet
    caster: Any


def _layers(surfaces: list[Surface], view: View, engine: str, smooth: bool, pool: Executor) -> list[_Layer]:
    """One for each surface that covers a pixel.

    raises  InputError for a surface that the source lies on
    """
    # Imported when used: who asks for one engine does not load the other.
    if engine == "embree":
        from .embree import Caster
    else:
        Caster = scanline.Caster  # type: ignore[assignment, misc]

    def layer(surface: Surface) -> _Layer | None:
        sheet = sheet_of(surface.solid, view)
        around = _around(sheet, view, surface.name)
        covers = sheet.rows[0] < sheet.rows[1] and sheet.cols[0] < sheet.cols[1]
        densities = (None, None) if smooth else (surface.inside_density, surface.outside_density)
        return _Layer(surface, densities, sheet, Caster(sheet, around)) if covers else None

    return [seen for seen in pool.map(layer, surfaces) if seen is not None]


def _around(sheet: Sheet, view: View, name: str) -> int:
    """How often a surface goes around the source, which the signs of every ray's crossings add up to."""
    if not sheet.cut:
        return 0
    bands = [
        scanline.windings(sheet, max(first, sheet.rows[0]), min(first + BAND_ROWS, sheet.rows[1]))
        for first in range(sheet.rows[0] // BAND_ROWS * BAND_ROWS, sheet.rows[1], BAND_ROWS)
    ]
    sums = {float(edge(band)) for band in bands if band.size for edge in (np.min, np.max)}
    if (sheet.rows, sheet.cols) != ((0, view.rows), (0, view.cols)):
        sums.add(0.0)
    if len(sums) > 1:
        raise InputError(f"{name}: the source lies on it, at {view.source_mm} mm; allowed: inside it or outside")
    return int(sums.pop())


def _band(scene: Scene, view: View, layers: list[_Layer], path_mm: Mapping[str, Any], first: int) -> Audit:
    """Fill the rows of one band, in every material; returns the audit of its rays."""
    stop = min(first + BAND_ROWS, view.rows)
    sums = {material: np.zeros((stop - first, view.cols)) for material in path_mm}
    frame, touched, audits = frame_of(view), {scene.ambient}, [Audit()]
    varying: _Varying = {}
    for layer in layers:
        surface, sheet = layer.surface, layer.sheet
        top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
        if top >= bottom:
            continue
        chord, crossings, audit = _cast(layer, top, bottom)
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
                _add(sums[material], chord, top - first, sheet.cols[0], sign)
    for (material, _), (density, parts, names) in varying.items():
        # Surfaces that share a density are integrated over together, so that what lies between them is seen once.
        whole = joined(parts)
        try:
            integral = integrals(whole, frame, density)
        except InputError as error:
            raise InputError(f"{', '.join(names)}: density of {material}: {error}") from None
        _add(sums[material], integral, whole.window.row - first, whole.window.col, +1)
    if scene.ambient in sums:
        add_box(frame, scene.bounds_mm, first, sums[scene.ambient])
    for material in touched & sums.keys():
        path_mm[material][first:stop] = to_mm(sums[material], frame, first)
    return total(audits)


def _add(sums: Array, lengths: Array, row: int, col: int, sign: int) -> None:
    part = sums[row : row + lengths.shape[0], col : col + lengths.shape[1]]
    (np.add if sign > 0 else np.subtract)(part, lengths, out=part)


def _cast(layer: _Layer, top: int, bottom: int) -> tuple[Array, Crossings | None, Audit]:
    """Chords within a surface, its crossings if a density needs them, and the audit of its rays."""
    if layer.densities == (None, None):
        chord, audit = layer.caster.chords(top, bottom)
        return chord, None, audit
    crossings, audit = layer.caster.crossings(top, bottom)
    return chords(crossings), crossings, audit
