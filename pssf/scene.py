"""Scene: closed surfaces and what is on either side of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from .checks import Array, InputError


@dataclass(frozen=True)
class Surface:
    """A closed mesh (mm, outward normals) between two materials.

    inside, outside  tissue names (`data/tissues.toml`), or "FORMULA@DENSITY" in g/cm3, such as "Ti@4.51"
    name             how the surface is called in exports and refusals
    raises           InputError for a mesh that is empty, open, inconsistently wound or not finite
    """

    mesh: trimesh.Trimesh
    inside: str
    outside: str
    name: str = "surface"

    def __post_init__(self) -> None:
        check_closed(self.mesh, self.name)
        for label, material in (("inside", self.inside), ("outside", self.outside)):
            if not isinstance(material, str) or not material:
                raise InputError(f"{self.name}: {label} = {material!r}; allowed: the name of a material")


@dataclass(frozen=True)
class Scene:
    """Surfaces in `ambient`. Each surface's `outside` is the material that immediately surrounds it."""

    surfaces: tuple[Surface, ...]
    ambient: str = "air"

    def __init__(self, surfaces: Sequence[Surface], ambient: str = "air") -> None:
        object.__setattr__(self, "surfaces", tuple(surfaces))
        object.__setattr__(self, "ambient", ambient)
        if not self.surfaces:
            raise InputError("scene: 0 surfaces; allowed: 1 or more")

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material named, ambient first, in the order of first appearance."""
        names = [self.ambient]
        for surface in self.surfaces:
            names += [surface.outside, surface.inside]
        return tuple(dict.fromkeys(names))

    @property
    def bounds_mm(self) -> Array:
        """(2, 3)  lower and upper corner of the box around all surfaces"""
        corners = np.array([surface.mesh.bounds for surface in self.surfaces])
        return np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def check_closed(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuse a mesh that cannot bound a solid.

    raises  InputError naming the surface, the count of bad faces, edges or vertices and the first of them
    """
    if len(mesh.faces) == 0:
        raise InputError(f"{name}: mesh has 0 faces; allowed: a closed mesh of 4 or more")
    bad = np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))
    if len(bad):
        raise InputError(f"{name}: {len(bad)} vertices are not finite, first {bad[0]}; allowed: finite coordinates")
    faces = mesh.faces
    directed = np.vstack((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])).astype(np.int64)
    count = len(mesh.vertices)
    forward = np.sort(directed[:, 0] * count + directed[:, 1])
    backward = np.sort(directed[:, 1] * count + directed[:, 0])
    # Closed and wound one way: every directed edge stands once for every time its reverse does.
    if not np.array_equal(forward, backward):
        lone = np.setxor1d(forward, backward)
        first = (int(lone[0] // count), int(lone[0] % count))
        raise InputError(
            f"{name}: mesh is open or wound both ways at {len(lone) // 2 or 1} edges, first between vertices "
            f"{first[0]} and {first[1]}; allowed: closed meshes with consistent winding"
        )
    if mesh.volume <= 0:
        raise InputError(f"{name}: volume = {mesh.volume:.6g} mm3 (inside out or flat); allowed: more than 0 mm3")
