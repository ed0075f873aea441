"""Scene: closed surfaces and what is on either side of each."""

import hashlib
import math
import re
import reprlib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..core.checks import Array, InputError, require
from ..core.keywords import keywords
from .density import Density
from .mesh import Mesh, MeshField, is_mesh
from .repair import Fault, Solid, repair, require_sound

if TYPE_CHECKING:
    import trimesh

# Smaller or larger than this across, and the unit is likely not the millimetre.
SIZE_MM = (5.0, 3000.0)
# Whatever the unit: here a micrometre is still resolved around a kilometre, and no square of a place overflows.
_EXTREME_MM = (1e-6, 1e12)


class MeshNotice(UserWarning):
    """A mesh was mended before it was traced; the message says where and how."""


@keywords()
@dataclass(frozen=True, eq=False)
class Surface:
    """A closed mesh (mm, outward normals) between two materials.

    mesh             a trimesh.Trimesh, or a Mesh, which becomes one when it is read
    inside, outside  tissue names (`data/tissues.toml`), "FORMULA@DENSITY" in g/cm3, such as "Ti@4.51", or percent by
                     mass, such as "Ti=90,Al=6,V=4@4.43"
    name             how the surface is called in exports and refusals
    inside_density   relative density of what is inside, where it varies; path lengths become its integrals
    outside_density  the same of what is outside: that of the surface around, where it has one (`trace` refuses None)
    raises           InputError for a wrong type or name; the mesh itself is judged by `check` and `trace`

    The mesh is read once, when it is first needed. Two surfaces are equal if they are one.
    """

    if TYPE_CHECKING:
        mesh: trimesh.Trimesh | Mesh
    else:
        mesh: Any = MeshField()
    inside: str
    outside: str
    name: str = "surface"
    inside_density: Density | None = None
    outside_density: Density | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r"[\w .-]{1,64}", self.name):
            raise InputError(f"surface name = {self.name!r}; allowed: 1 to 64 letters, digits, _, -, . and blanks")
        if not is_mesh(held := self.__dict__["_mesh"]):
            raise InputError(f"{self.name}: mesh = {reprlib.repr(held)}; allowed: a trimesh.Trimesh")
        for label, material in (("inside", self.inside), ("outside", self.outside)):
            if not isinstance(material, str) or not material:
                raise InputError(f"{self.name}: {label} = {material!r}; allowed: the name of a material")
        for label, density in (("inside_density", self.inside_density), ("outside_density", self.outside_density)):
            if density is not None and not isinstance(density, Density):
                raise InputError(
                    f"{self.name}: {label} = {reprlib.repr(density)}; allowed: None, or a Density such as PlaneWaves"
                )

    def __repr__(self) -> str:
        densities = (("inside_density", self.inside_density), ("outside_density", self.outside_density))
        varying = "".join(f", {label}={type(value).__name__}" for label, value in densities if value is not None)
        faces = f"{len(self.arrays.faces)} faces"
        return f"Surface({self.name!r}, inside={self.inside!r}, outside={self.outside!r}, {faces}{varying})"

    @property
    def arrays(self) -> Mesh:
        """Vertices and faces of the mesh, without trimesh."""
        return MeshField.arrays(self)

    def table(self) -> dict[str, Any]:
        """Name, materials, densities that vary by what they are, size of the mesh and its hash, JSON-ready."""
        vertices, faces = self.arrays
        digest = hashlib.sha256(np.ascontiguousarray(vertices, "<f8").tobytes())
        digest.update(np.ascontiguousarray(faces, "<i8").tobytes())
        densities = (("inside_density", self.inside_density), ("outside_density", self.outside_density))
        return {
            **{"name": self.name, "inside": self.inside, "outside": self.outside},
            **{label: type(density).__name__ for label, density in densities if density is not None},
            **{"vertices": len(vertices), "faces": len(faces), "sha256": digest.hexdigest()},
        }

    @cached_property
    def solid(self) -> Solid:
        """What the mesh bounds, mended where only one reading is possible, with an account of it."""
        return repair(*self.arrays, self.name)

    @property
    def bounds_mm(self) -> Array:
        """(2, 3)  lower and upper corner of the box around it"""
        points = self.solid.points
        return np.array([[edge(points[:, axis]) for axis in range(3)] for edge in (np.min, np.max)])


@keywords()
@dataclass(frozen=True, eq=False)
class Scene:
    """Surfaces in `ambient`. Each surface's `outside` is the material that immediately surrounds it.

    ambient  air or another gas: it attenuates nothing, and `simulate` refuses a denser one. Water around a phantom is a
             closed surface of water in air
    size_mm  least and greatest extent; outside of it the unit is doubted. (0, inf) allows any
             Without surfaces its radiograph is a flat field
    raises   InputError for wrong types; meshes and size are judged by `check` and `trace`

    Two scenes are equal if they are one.
    """

    surfaces: tuple[Surface, ...]
    ambient: str = "air"
    size_mm: tuple[float, float] = SIZE_MM

    def __init__(
        self, surfaces: Iterable[Surface], ambient: str = "air", size_mm: tuple[float, float] = SIZE_MM
    ) -> None:
        if not isinstance(surfaces, Iterable):
            raise InputError(f"scene: surfaces = {reprlib.repr(surfaces)}; allowed: a list of Surface")
        object.__setattr__(self, "surfaces", tuple(surfaces))
        object.__setattr__(self, "ambient", ambient)
        object.__setattr__(self, "size_mm", _span_of(size_mm))
        for surface in self.surfaces:
            if not isinstance(surface, Surface):
                raise InputError(f"scene: {reprlib.repr(surface)} among the surfaces; allowed: Surface")
        if not isinstance(ambient, str) or not ambient:
            raise InputError(f"scene: ambient = {ambient!r}; allowed: the name of a material")

    @property
    def materials(self) -> tuple[str, ...]:
        """Every material named, ambient first, in the order of first appearance."""
        names = [self.ambient]
        for surface in self.surfaces:
            names += [surface.outside, surface.inside]
        return tuple(dict.fromkeys(names))

    def table(self) -> dict[str, Any]:
        """What it is made of, JSON-ready: what is around all, and every surface's own."""
        return {"ambient": self.ambient, "surfaces": [surface.table() for surface in self.surfaces]}

    @cached_property
    def bounds_mm(self) -> Array:
        """(2, 3)  lower and upper corner of the box around all surfaces

        raises  InputError for a mesh that bounds no solid
        """
        if not self.surfaces:
            return np.zeros((2, 3))
        for surface in self.surfaces:
            require_sound(surface.solid)
        corners = np.array([surface.bounds_mm for surface in self.surfaces])
        return np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is wrong with the meshes, in the order of the surfaces, and then with the size of it all."""
        faults = [fault for surface in self.surfaces for fault in surface.solid.faults]
        if not self.surfaces or any(fault.outcome == "refused" for fault in faults):
            return tuple(faults)
        low, high = max(self.size_mm[0], _EXTREME_MM[0]), min(self.size_mm[1], _EXTREME_MM[1])
        # Halves, so that what spans all of float64 does not overflow.
        across_mm = 2.0 * float((self.bounds_mm[1] / 2 - self.bounds_mm[0] / 2).max())
        away_mm = float(abs(self.bounds_mm).max())
        what = hint = ""
        if not low <= across_mm <= high:
            what = f"scene is {across_mm:.4g} mm across"
            other = "" if self.size_mm[0] <= across_mm <= self.size_mm[1] else "; or Scene(..., size_mm=...)"
            hint = f"allowed: {low:g} to {high:g} mm{_unit_hint(across_mm, low, high)}{other}"
        elif away_mm > _EXTREME_MM[1]:
            what, hint = f"scene is {away_mm:.4g} mm from the origin", f"allowed: up to {_EXTREME_MM[1]:g} mm"
        if what:
            faults.append(Fault(surface="scene", what=what, count=0, first=(), outcome="refused", hint=hint))
        return tuple(faults)


class HasScene(Protocol):
    """Something that was built and carries its scene, as `build(knee)` gives it."""

    @property
    def scene(self) -> Scene:
        """Its closed surfaces."""


def scene_of(thing: Scene | HasScene) -> Scene:
    """A scene, or that of what was built.

    raises  InputError for anything else
    """
    scene = thing if isinstance(thing, Scene) else getattr(thing, "scene", None)
    if not isinstance(scene, Scene):
        raise InputError(f"scene = {reprlib.repr(thing)}; allowed: a Scene, or what build(knee) gives")
    return scene


def require_traceable(scene: Scene) -> None:
    """Refuse a scene that has no right answer; warn once of what was mended.

    raises  InputError naming each surface, the count of bad faces, edges or vertices and the first of them
    warns   MeshNotice
    """
    faults = scene.faults
    refused = [str(fault) for fault in faults if fault.outcome == "refused"]
    if refused:
        raise InputError("; ".join(refused))
    for fault in faults:
        if fault.outcome == "mended":
            warnings.warn(str(fault), MeshNotice, stacklevel=3)


def _span_of(size_mm: tuple[float, float]) -> tuple[float, float]:
    """A least and a greatest extent, mm, made sure of."""
    if not isinstance(size_mm, tuple | list | np.ndarray) or len(size_mm) != 2:
        raise InputError(f"scene: size_mm = {size_mm!r}; allowed: two numbers, least and greatest extent in mm")
    low, high = size_mm
    require("scene: size_mm[1]", high, 0, math.inf, "mm")
    require("scene: size_mm[0]", low, 0, high, "mm")
    return float(low), float(high)


def _unit_hint(across_mm: float, low: float, high: float) -> str:
    """Which other unit would make sense of a size."""
    for unit, factor in (("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4), ("micrometres", 0.001)):
        if low <= across_mm * factor <= high:
            return f" (is the mesh in {unit}? mesh.apply_scale({factor:g}))"
    return ""
