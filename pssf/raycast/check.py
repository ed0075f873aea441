"""check: what is wrong with a scene, before any image is made of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..core.keywords import keywords
from ..data.tissues import DENSEST_GAS, Tissue, tissues
from ..geometry.repair import Fault
from ..geometry.scene import HasScene, Scene, Surface, scene_of
from ..geometry.view import View, depth_of, view_of
from ..model.protocol import Protocol
from .clip import NEAREST
from .density_mismatch import density_faults
from .negative import least_paths, why_negative
from .overlaps import contradictions, folded
from .paths import FOLD_MM
from .sheets import sheet_of

# Sample rays across the box of a scene, and how many times its size the source is away from it.
_SIDE = 128
_AWAY = 7.3
# Fault of a surface outside the field of view.
COVERS_NO_PIXEL = "covers no pixel"
_SHOWN = "sample rays that show it"


@dataclass(frozen=True)
class Report:
    """What `check` gives. `str(report)` has a line for each fault, in the order of Scene.faults, then the notes."""

    faults: tuple[Fault, ...]

    @property
    def ok(self) -> bool:
        """Whether `trace` takes the scene."""
        return not any(fault.outcome == "refused" for fault in self.faults)

    def __str__(self) -> str:
        return "\n".join(f"{fault.outcome}: {fault}" for fault in self.faults) or "no faults"


@keywords()
def check(scene: Scene | HasScene, protocol: Protocol | View | None = None) -> Report:
    """What is wrong with a scene, surface by surface.

    "refused" and "mended" are what `trace` refuses and mends. "noted" is traced as it is: edges of more than two faces,
    a mesh that overlaps itself (there path counts as often as the mesh goes around), a surface that says it is
    surrounded by what rays do not find there, and over how many millimetres, paths of a little less than nothing.
    Materials are names here: `simulate` refuses those that it does not know, before rays are cast.

    scene     surfaces, or what carries them, as `build(knee)` gives it
    protocol  with it, the paths of that very view are looked at, and also what is behind the source, behind the
              detector or outside of the field; without it, paths along 128 x 128 rays across the scene
    raises    InputError for what is no scene, protocol or view
    """
    scene = scene_of(scene)
    view = None if protocol is None else view_of(protocol)
    faults = list(scene.faults)
    smooth = isinstance(protocol, Protocol) and protocol.texture == "none"
    if not smooth:
        faults += density_faults(scene)
    if scene.surfaces and not any(fault.outcome == "refused" for fault in faults):
        sample = _sample_view(scene.bounds_mm)
        for surface in scene.surfaces:
            faults += _crowded_edges(surface)
        faults += [
            *_dense_ambient(scene, tissues()),
            *_overlaps(scene, sample, smooth),
            *_negative_paths(scene, view or sample),
        ]
        if view is not None:
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
    number = surface.solid.vertices
    first = tuple(f"{number[edge >> 32]}-{number[edge & 0xFFFFFFFF]}" for edge in crowded[:3])
    return [_noted(surface.name, "edges of more than two faces", len(crowded), first, "signs add up all the same")]


def _dense_ambient(scene: Scene, known: Mapping[str, Tissue]) -> list[Fault]:
    """An ambient material, where its density is known by its name, that would attenuate: `simulate` refuses it."""
    tissue, _, given = known.get(scene.ambient), *scene.ambient.partition("@")[1:]
    try:
        # A mix of tissues, which has no density of its own, is none of gases.
        density = float(given) if tissue is None else tissue.density or 1.0
    except ValueError:
        return []
    if density <= DENSEST_GAS:
        return []
    hint = "simulate refuses it; put the scene into a closed surface of that material in air"
    return [_noted("ambient", f"{scene.ambient} attenuates nothing outside of all surfaces", 0, (), hint)]


def _overlaps(scene: Scene, sample: View, smooth: bool) -> list[Fault]:
    """Meshes that overlap themselves, and surfaces that contradict each other, on sample rays.

    smooth  whether every material is taken at its own density, whatever surfaces say of theirs
    """
    faults = []
    for fold in folded(scene, sample):
        what = f"mesh overlaps itself or has a body inside out, over up to {fold.longest_mm:.3g} mm of a ray; {_SHOWN}"
        name, hint = scene.surfaces[fold.surface].name, "path counts as often as the mesh goes around"
        faults.append(_noted(name, what, fold.rays, (), hint))
    contrary = [one for one in contradictions(scene, sample) if not (smooth and one.is_of_density)]
    pairs = {(one.surface, one.owner) for one in contrary}
    for one in contrary:
        mutual = (one.owner, one.surface) in pairs
        hint = f"it and {one.owner} overlap" if mutual else "its outside is wrong, or it lies where it should not"
        faults.append(_noted(one.surface, f"{one}; {_SHOWN}", one.rays, (), hint))
    return faults


def _negative_paths(scene: Scene, view: View) -> list[Fault]:
    """Materials whose paths come out negative: what `trace` refuses, and what it does not."""
    faults = []
    for material, least in least_paths(scene, view).items():
        if least.mm < -FOLD_MM:
            what = f"path length comes out negative, down to {least.mm:.4g} mm; rays that show it"
            hint = f"{why_negative(scene, view, material, least.row, least.col)}; allowed: {-FOLD_MM:g} mm or more"
            faults.append(replace(_noted(material, what, least.negative, (), hint), outcome="refused"))
        elif least.negative:
            what = f"path length comes out negative, but no further than {least.mm:.4g} mm; rays that show it"
            hint = "as where a mesh is folded; it is traced as it is"
            faults.append(_noted(material, what, least.negative, (), hint))
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
        faults.append(_noted(surface.name, COVERS_NO_PIXEL, 0, (), "it is not in the image"))
    return faults
