"""Cut overlapping bodies of a scene, so that each point belongs to the surface that is listed first."""

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from manifold3d import Manifold

from ..anatomy.meshing.solids import build_solid, extract_mesh
from ..geometry.scene import Scene, Surface, require_traceable

# Volume, relative to that of a solid, below which a remainder is due to rounding.
_ROUNDING = 1e-9
# Scene with cut bodies of each scene, so that later calls return the same object. The value is None if nothing is cut,
# because a value that refers to its own key would keep the scene in memory.
_CUT_SCENES: "WeakKeyDictionary[Scene, Scene | None]" = WeakKeyDictionary()


def resolve_overlaps(scene: Scene) -> Scene:
    """Apply the overlap rule of a scene.

    Parameters
    ----------
    scene : Scene
        Closed surfaces. If the rule is ``"first"``, bodies with the same outside material are cut by all bodies that
        are listed before them.

    Returns
    -------
    Scene
        Scene without overlaps, or `scene` itself if it has another rule or no overlap. The same scene always yields the
        same object.

    Raises
    ------
    InputError
        If a mesh does not bound a solid.
    """
    if scene.overlap != "first" or len(scene.surfaces) < 2:
        return scene
    if scene not in _CUT_SCENES:
        _CUT_SCENES[scene] = _cut_bodies(scene)
    return _CUT_SCENES[scene] or scene


def _cut_bodies(scene: Scene) -> Scene | None:
    """Subtract each body from the later bodies with the same outside material, and from everything inside them.

    Return None if no bodies overlap.
    """
    require_traceable(scene)
    surfaces = scene.surfaces
    solids = [build_solid(one.solid.points, one.solid.faces, one.name) for one in surfaces]
    inside = [_find_contents(number, surfaces, solids) for number in range(len(surfaces))]
    cut: set[int] = set()
    for first in range(len(surfaces)):
        for later in range(first + 1, len(surfaces)):
            if surfaces[first].outside != surfaces[later].outside or not _overlap(solids[first], solids[later]):
                continue
            for number in (later, *inside[later]):
                if number != first and number not in inside[first] and _overlap(solids[first], solids[number]):
                    solids[number] -= solids[first]
                    cut.add(number)
    if not cut:
        return None
    left = [
        replace(surface, mesh=extract_mesh(solids[number])) if number in cut else surface
        for number, surface in enumerate(surfaces)
        if number not in cut or solids[number].volume() > 0
    ]
    return Scene(left, scene.ambient, scene.size_mm, overlap="sum")


def _find_contents(number: int, surfaces: tuple[Surface, ...], solids: list[Manifold]) -> list[int]:
    """Find the surfaces inside a surface, at any depth, by their materials and volumes."""
    contents, hosts = list[int](), [number]
    while hosts:
        host = hosts.pop()
        for other, surface in enumerate(surfaces):
            if other in (number, *contents) or surface.outside != surfaces[host].inside:
                continue
            if (solids[other] - solids[host]).volume() <= _ROUNDING * solids[other].volume():
                contents.append(other)
                hosts.append(other)
    return contents


def _overlap(one: Manifold, other: Manifold) -> bool:
    """Return whether two solids share more volume than rounding explains."""
    if one.is_empty() or other.is_empty():
        return False
    low_one, high_one, low_other, high_other = (
        np.array(corner) for solid in (one, other) for corner in np.reshape(solid.bounding_box(), (2, 3))
    )
    if (high_one <= low_other).any() or (high_other <= low_one).any():
        return False
    return bool((one ^ other).volume() > _ROUNDING * min(one.volume(), other.volume()))
