"""Scene: closed surfaces and what is on either side of each."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

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
        if not isinstance(self.name, str) or not re.fullmatch(r"[\w .-]{1,64}", self.name):
            raise InputError(f"surface name = {self.name!r}; allowed: 1 to 64 letters, digits, _, -, . and blanks")
        if not isinstance(self.mesh, trimesh.Trimesh):
            raise InputError(f"{self.name}: mesh is a {type(self.mesh).__name__}; allowed: trimesh.Trimesh")
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
        for surface in self.surfaces:
            if not isinstance(surface, Surface):
                raise InputError(f"scene: {type(surface).__name__} among the surfaces; allowed: Surface")
        if not isinstance(ambient, str) or not ambient:
            raise InputError(f"scene: ambient = {ambient!r}; allowed: the name of a material")

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
    start, end = (np.asarray(mesh.faces, np.uint64)[:, order].ravel() for order in ([0, 1, 2], [1, 2, 0]))
    # Closed and wound one way: every directed edge stands once for every time its reverse does. Sums of 64-bit hashes
    # tell it without sorting; they agree by accident once in 1e19.
    if _hashed(start, end) != _hashed(end, start):
        _refuse_open(start, end, name)
    volume = volume_mm3(mesh)
    if volume <= 0:
        raise InputError(f"{name}: volume = {volume:.6g} mm3 (inside out or flat); allowed: more than 0 mm3")


def volume_mm3(mesh: trimesh.Trimesh) -> float:
    """Signed volume of a closed mesh, mm3."""
    corners = np.asarray(mesh.vertices)[mesh.faces] - mesh.vertices[0]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def _hashed(start: NDArray[np.uint64], end: NDArray[np.uint64]) -> int:
    """Sum of the hashes of directed edges (SplitMix64, Steele et al. 2014)."""
    key = start * np.uint64(0x9E3779B97F4A7C15) + end * np.uint64(0xD1B54A32D192ED03)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        key = (key ^ (key >> np.uint64(shift))) * np.uint64(factor)
    return int((key ^ (key >> np.uint64(31))).sum(dtype=np.uint64))


def _refuse_open(start: NDArray[np.uint64], end: NDArray[np.uint64], name: str) -> None:
    count = int(max(start.max(), end.max())) + 1
    forward, backward = np.sort(start * np.uint64(count) + end), np.sort(end * np.uint64(count) + start)
    lone = np.setxor1d(forward, backward)
    lone = lone if len(lone) else forward[forward != backward]
    first = divmod(int(lone[0]), count)
    raise InputError(
        f"{name}: mesh is open or wound both ways at {len(lone) // 2 or 1} edges, first between vertices "
        f"{first[0]} and {first[1]}; allowed: closed meshes with consistent winding"
    )
