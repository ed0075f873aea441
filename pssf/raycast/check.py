"""check: what is wrong with a scene, before any image is made of it."""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array
from ..geometry.repair import Fault
from ..geometry.scene import Scene, Surface
from ..geometry.view import View, depth_of, view_of
from ..model.protocol import Protocol
from . import scanline
from .clip import NEAREST
from .crossings import chords
from .sheets import BAND_ROWS, sheet_of

# Sample rays across the box of a scene, and how many times its size the source is away from it.
_SIDE = 128
_AWAY = 7.3


@dataclass(frozen=True)
class Report:
    """What was found. `str(report)` has a line for each fault."""

    faults: tuple[Fault, ...]

    @property
    def ok(self) -> bool:
        """Whether `trace` takes the scene."""
        return not any(fault.outcome == "refused" for fault in self.faults)

    def __str__(self) -> str:
        return "\n".join(f"{fault.outcome}: {fault}" for fault in self.faults) or "no faults"


def check(scene: Scene, protocol: Protocol | View | None = None) -> Report:
    """What is wrong with a scene, surface by surface.

    "refused" and "mended" are what `trace` refuses and mends. "noted" is traced as it is: edges of more than two faces,
    a mesh that overlaps itself (there path counts as often as the mesh goes around), a material whose paths come out
    negative because a surface says it is surrounded by what it is not; the last two are found on sample rays. With a
    protocol also what is behind the source, behind the detector or outside of the field.
    """
    faults = list(scene.faults)
    if not any(fault.outcome == "refused" for fault in faults):
        for surface in scene.surfaces:
            faults += _crowded_edges(surface)
        faults += _odd_paths(scene)
        if protocol is not None:
            view = protocol if isinstance(protocol, View) else view_of(protocol)
            faults += [fault for surface in scene.surfaces for fault in _places(surface, view)]
    return Report(tuple(faults))


def _noted(surface: str, what: str, count: int, first: tuple[object, ...], hint: str) -> Fault:
    return Fault(surface=surface, what=what, count=count, first=first, outcome="noted", hint=hint)


def _crowded_edges(surface: Surface) -> list[Fault]:
    faces = surface.solid.faces.astype(np.int64)
    start, end = (faces[:, order].ravel() for order in ([0, 1, 2], [1, 2, 0]))
    keys = np.minimum(start, end) << 32 | np.maximum(start, end)
    edges, degree = np.unique(keys, return_counts=True)
    crowded = edges[degree > 2]
    if not len(crowded):
        return []
    first = tuple(f"{edge >> 32}-{edge & 0xFFFFFFFF}" for edge in crowded[:3])
    return [_noted(surface.name, "edges of more than two faces", len(crowded), first, "signs add up all the same")]


def _odd_paths(scene: Scene) -> list[Fault]:
    """Faults that sample rays show."""
    view, faults = _sample_view(scene.bounds_mm), []
    paths = {material: np.zeros((_SIDE, _SIDE)) for material in scene.materials}
    for surface in scene.surfaces:
        sheet = sheet_of(surface.solid, view)
        overlapping = 0
        for first in range(0, _SIDE, BAND_ROWS):
            top, bottom = max(first, sheet.rows[0]), min(first + BAND_ROWS, sheet.rows[1])
            if top >= bottom:
                continue
            found = scanline.crossings(sheet, top, bottom)
            of_ray = np.repeat(np.arange(len(found.starts) - 1), np.diff(found.starts))
            # The signs of every ray add up to zero, so one sum serves all of them.
            around = -np.cumsum(found.sign, dtype=np.int64)
            overlapping += len(np.unique(of_ray[(around < 0) | (around > 1)]))
            for material, sign in ((surface.inside, 1), (surface.outside, -1)):
                paths[material][top:bottom, slice(*sheet.cols)] += sign * chords(found)
        if overlapping:
            what = "mesh overlaps itself or has a body inside out, sample rays that show it"
            faults.append(_noted(surface.name, what, overlapping, (), "path counts as often as the mesh goes around"))
    for material in scene.materials:
        negative = int((paths[material] < -1e-9).sum())
        if negative and material != scene.ambient:
            what = "path length comes out negative, sample rays that show it"
            hint = "a surface has it outside where it is not, or two surfaces overlap"
            faults.append(_noted(material, what, negative, (), hint))
    return faults


def _sample_view(bounds_mm: Array) -> View:
    """Rays through the whole of a box, nearly parallel, and off any axis."""
    centre, size = bounds_mm.mean(axis=0), float(np.ptp(bounds_mm, axis=0).max())
    source = centre + size * np.array([0.0137, -_AWAY, 0.0173])
    magnified = (_AWAY + 1) / (_AWAY - 0.5)
    return View(
        source_mm=(float(source[0]), float(source[1]), float(source[2])),
        centre_mm=(float(centre[0]), float(centre[1] + size), float(centre[2])),
        rows=_SIDE,
        cols=_SIDE,
        pixel_mm=1.05 * magnified * size / _SIDE,
    )


def _places(surface: Surface, view: View) -> list[Fault]:
    depth = depth_of(surface.solid.points, view)
    sheet = sheet_of(surface.solid, view)
    faults = []
    for what, count in (
        ("vertices behind the source", int((depth < NEAREST).sum())),
        ("vertices behind the detector", int((depth > 1).sum())),
    ):
        if count:
            faults.append(_noted(surface.name, what, count, (), "that part is not on the way of any ray"))
    if sheet.rows[0] >= sheet.rows[1] or sheet.cols[0] >= sheet.cols[1]:
        faults.append(_noted(surface.name, "covers no pixel", 0, (), "it is not in the image"))
    return faults
