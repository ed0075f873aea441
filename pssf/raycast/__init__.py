"""raycast.trace    scene, protocol  -> path lengths per material, (rows, cols), and an audit of the rays

paths     what comes back
sheets    surfaces as a detector sees them
rays      their lengths, and where they meet a box
scanline  engine: triangles projected and accumulated in float64
embree    engine: rays cast hit by hit, audited, repaired by scanline
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..checks import Array, require_choice, require_whole
from ..geometry import View, view_of
from ..protocol import Protocol
from ..scene import Scene, Surface
from .paths import Audit, Paths, total
from .rays import add_box, to_mm
from .sheets import BAND_ROWS, Sheet, frame_of, sheet_of

__all__ = ["Audit", "Paths", "trace"]

ENGINES = ("embree", "scanline")
Caster = Callable[[int, int], tuple[Array, Audit]]


def trace(
    scene: Scene,
    protocol: Protocol | View,
    *,
    engine: str = "embree",
    materials: Iterable[str] | None = None,
    workers: int = 2,
) -> Paths:
    """Path length in each material along every ray from the source to a pixel centre.

    A closed surface that a ray crosses contributes sign x t at each crossing, + on leaving, - on entering; the path in
    a material is the sum over surfaces with it inside minus the sum over those with it outside, in float64.

    materials  those wanted; by default all but the ambient one, whose path is counted inside the box around the scene
    workers    threads; they do not change the result
    returns    path_mm (rows, cols) float32 per material, and the audit
    raises     InputError for an unknown engine or material, or a surface that is not between source and detector
    """
    require_choice("engine", engine, ENGINES)
    require_whole("workers", workers, 1, 256, "threads")
    wanted = list(dict.fromkeys(scene.materials[1:] if materials is None else materials))
    for material in wanted:
        require_choice("material", material, scene.materials)
    view = protocol if isinstance(protocol, View) else view_of(protocol)
    path_mm = {material: np.zeros((view.rows, view.cols), np.float32) for material in wanted}
    with ThreadPoolExecutor(workers) as pool:
        sheets = list(pool.map(partial(sheet_of, view=view), scene.surfaces))
        layers = list(zip(scene.surfaces, sheets, pool.map(_caster(engine), sheets), strict=True))
        audits = pool.map(partial(_band, scene, view, layers, path_mm), range(0, view.rows, BAND_ROWS))
        return Paths(path_mm=path_mm, audit=total(audits))


def _caster(engine: str) -> Callable[[Sheet], Caster]:
    # Imported when used: who asks for one engine does not load the other.
    if engine == "embree":
        from .embree import caster
    else:
        from .scanline import caster
    return caster


def _band(
    scene: Scene,
    view: View,
    layers: list[tuple[Surface, Sheet, Caster]],
    path_mm: dict[str, NDArray[np.float32]],
    first: int,
) -> Audit:
    """Fill the rows of one band, in every material; returns the audit of its rays."""
    stop = min(first + BAND_ROWS, view.rows)
    sums = {material: np.zeros((stop - first, view.cols)) for material in path_mm}
    touched = {scene.ambient}
    audits = [Audit()]
    for surface, sheet, cast in layers:
        top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
        if top >= bottom or sheet.cols[0] >= sheet.cols[1]:
            continue
        chord, audit = cast(top, bottom)
        audits.append(audit)
        for material, add in ((surface.inside, np.add), (surface.outside, np.subtract)):
            if material in sums:
                part = sums[material][top - first : bottom - first, sheet.cols[0] : sheet.cols[1]]
                add(part, chord, out=part)
                touched.add(material)
    frame = frame_of(view)
    if scene.ambient in sums:
        add_box(frame, scene.bounds_mm, first, sums[scene.ambient])
    for material in touched & sums.keys():
        to_mm(sums[material], frame, first, path_mm[material][first:stop])
    return total(audits)
