"""Scenes of closed surfaces with inside and outside materials."""

import hashlib
import math
import re
import reprlib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..core.checks import Array, InputError, require_choice, require_in_range
from ..core.keyword_arguments import check_keywords
from .density import Density
from .mesh import Mesh, MeshField, is_mesh
from .mesh_repair import (
    Fault,
    Solid,
    repair_mesh,
    require_usable_solid,
)

if TYPE_CHECKING:
    import trimesh

# Range of plausible scene extents, in mm. A scene outside this range probably has a unit other than mm.
SIZE_RANGE_MM = (5.0, 3000.0)
# Smallest and largest allowed extent of any scene, in mm. Within this range, squared coordinates do not overflow, and
# float64 coordinates resolve 1 um in a scene with an extent of 1 km.
_SIZE_LIMITS_MM = (1e-6, 1e12)


# Rules for bodies that overlap.
OVERLAP_RULES = ("warn", "refuse", "first", "sum")


class MeshNotice(UserWarning):
    """Warning that a mesh was repaired before ray casting. The message describes the faults and the repair."""


@check_keywords()
@dataclass(frozen=True, eq=False)
class Surface:
    """Closed mesh between two materials.

    Two surfaces are equal only if they are the same object.

    Parameters
    ----------
    mesh : trimesh.Trimesh or Mesh
        Closed mesh in mm with outward normals. The attribute is always returned as a trimesh.Trimesh. The mesh is
        repaired when it is first used.
    inside : str
        Material inside the mesh: the name of a tissue (``data/tissues.toml``), ``"FORMULA@DENSITY"`` in g/cm3 such as
        ``"Ti@4.51"``, or percent by mass such as ``"Ti=90,Al=6,V=4@4.43"``.
    outside : str
        Material outside the mesh, in the same notation as `inside`.
    name : str, default "surface"
        Name of the surface in exports and error messages: 1 to 64 letters, digits, ``_``, ``-``, ``.`` and spaces.
    inside_density : Density, optional
        Relative density of the material inside, if the density varies. Path lengths are then integrals of the relative
        density.
    outside_density : Density, optional
        Relative density of the material outside. The density must be the `inside_density` of the surrounding surface;
        otherwise, `trace` raises InputError.

    Raises
    ------
    InputError
        If an argument has the wrong type or the name is invalid. The mesh is validated later, by `check` and `trace`.
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
            raise InputError(f"surface name must be 1 to 64 letters, digits, _, -, . and spaces, got {self.name!r}")
        if not is_mesh(held := self.__dict__["_mesh"]):
            raise InputError(f"{self.name}: mesh must be a trimesh.Trimesh, got {reprlib.repr(held)}")
        for label, material in (("inside", self.inside), ("outside", self.outside)):
            if not isinstance(material, str) or not material:
                raise InputError(f"{self.name}: {label} must be the name of a material, got {material!r}")
        for label, density in (("inside_density", self.inside_density), ("outside_density", self.outside_density)):
            if density is not None and not isinstance(density, Density):
                raise InputError(
                    f"{self.name}: {label} must be None or a Density such as PlaneWaves, got {reprlib.repr(density)}"
                )

    def __repr__(self) -> str:
        densities = (("inside_density", self.inside_density), ("outside_density", self.outside_density))
        varying = "".join(f", {label}={type(value).__name__}" for label, value in densities if value is not None)
        faces = f"{len(self.mesh_arrays.faces)} faces"
        return f"Surface({self.name!r}, inside={self.inside!r}, outside={self.outside!r}, {faces}{varying})"

    @property
    def mesh_arrays(self) -> Mesh:
        """Vertices and faces of the mesh, without importing trimesh."""
        return MeshField.mesh_arrays(self)

    def table(self) -> dict[str, Any]:
        """Describe the surface for the metadata of a radiograph.

        Returns
        -------
        dict
            JSON-ready dict with name, materials, density types, and size and SHA-256 hash of the mesh.
        """
        vertices, faces = self.mesh_arrays
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
        """Repaired mesh with a list of its faults."""
        return repair_mesh(*self.mesh_arrays, self.name)

    @property
    def bounds_mm(self) -> Array:
        """Bounding box of the surface: lowest and highest corner as a (2, 3) array, in mm."""
        points = self.solid.points
        return np.array([[edge(points[:, axis]) for axis in range(3)] for edge in (np.min, np.max)])


@check_keywords()
@dataclass(frozen=True, eq=False)
class Scene:
    """Closed surfaces in a surrounding gas.

    The `outside` material of each surface is the material that immediately surrounds the surface. Two scenes are equal
    only if they are the same object. A scene without surfaces yields a flat-field radiograph.

    Parameters
    ----------
    surfaces : iterable of Surface
        Surfaces of the scene.
    ambient : str, default "air"
        Gas around all surfaces. The gas does not attenuate, and `simulate` raises InputError for a denser material. For
        a phantom in water, add a closed surface that is filled with water and surrounded by air.
    size_mm : tuple of float, default (5.0, 3000.0)
        Smallest and largest plausible extent of the scene, in mm. An extent outside this range suggests a wrong unit,
        so `check` reports an error and `trace` raises InputError. ``(0, inf)`` allows any extent.
    overlap : {"warn", "refuse", "first", "sum"}, default "warn"
        Rule for bodies that overlap, and for other surfaces whose outside material is not the material around them.
        ``"sum"`` counts the path in every body. ``"warn"`` does the same, and `simulate` gives a warning. With
        ``"refuse"``, `simulate` raises InputError. With ``"first"``, a point that several bodies with the same outside
        material contain belongs to the body that is listed first.

    Raises
    ------
    InputError
        If an argument has the wrong type. Meshes and extent are validated later, by `check` and `trace`.
    """

    surfaces: tuple[Surface, ...]
    ambient: str = "air"
    size_mm: tuple[float, float] = SIZE_RANGE_MM
    overlap: str = field(default="warn", repr=False)

    def __init__(
        self,
        surfaces: Iterable[Surface],
        ambient: str = "air",
        size_mm: tuple[float, float] = SIZE_RANGE_MM,
        overlap: str = "warn",
    ) -> None:
        if not isinstance(surfaces, Iterable):
            raise InputError(f"scene: surfaces must be a list of Surface, got {reprlib.repr(surfaces)}")
        object.__setattr__(self, "surfaces", tuple(surfaces))
        object.__setattr__(self, "ambient", ambient)
        object.__setattr__(self, "size_mm", _require_size_range(size_mm))
        require_choice("overlap", overlap, OVERLAP_RULES)
        object.__setattr__(self, "overlap", overlap)
        for surface in self.surfaces:
            if not isinstance(surface, Surface):
                raise InputError(f"scene: every surface must be a Surface, got {reprlib.repr(surface)}")
        if not isinstance(ambient, str) or not ambient:
            raise InputError(f"scene: ambient must be the name of a material, got {ambient!r}")

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of all materials in order of first appearance; the ambient gas is first."""
        names = [self.ambient]
        for surface in self.surfaces:
            names += [surface.outside, surface.inside]
        return tuple(dict.fromkeys(names))

    def table(self) -> dict[str, Any]:
        """Describe the scene for the metadata of a radiograph.

        Returns
        -------
        dict
            JSON-ready dict with the ambient gas and a description of every surface.
        """
        rule = {} if self.overlap == "warn" else {"overlap": self.overlap}
        return {"ambient": self.ambient, **rule, "surfaces": [surface.table() for surface in self.surfaces]}

    @cached_property
    def bounds_mm(self) -> Array:
        """Bounding box of all surfaces: lowest and highest corner as a (2, 3) array, in mm.

        Raises
        ------
        InputError
            If a mesh does not bound a solid.
        """
        if not self.surfaces:
            return np.zeros((2, 3))
        for surface in self.surfaces:
            require_usable_solid(surface.solid)
        corners = np.array([surface.bounds_mm for surface in self.surfaces])
        return np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults of all meshes in surface order, followed by a fault if the extent of the scene is implausible."""
        faults = [fault for surface in self.surfaces for fault in surface.solid.faults]
        if not self.surfaces or any(fault.outcome == "error" for fault in faults):
            return tuple(faults)
        low, high = max(self.size_mm[0], _SIZE_LIMITS_MM[0]), min(self.size_mm[1], _SIZE_LIMITS_MM[1])
        # The coordinates are halved before subtraction, because the difference of very large numbers could overflow.
        across_mm = 2.0 * float((self.bounds_mm[1] / 2 - self.bounds_mm[0] / 2).max())
        away_mm = float(abs(self.bounds_mm).max())
        what = hint = ""
        if not low <= across_mm <= high:
            what = f"scene is {across_mm:.4g} mm across"
            other = "" if self.size_mm[0] <= across_mm <= self.size_mm[1] else "; or set Scene(..., size_mm=...)"
            hint = f"the extent must be {low:g} to {high:g} mm{_suggest_unit(across_mm, low, high)}{other}"
        elif away_mm > _SIZE_LIMITS_MM[1]:
            what = f"scene extends {away_mm:.4g} mm from the origin"
            hint = f"the distance must be at most {_SIZE_LIMITS_MM[1]:g} mm"
        if what:
            faults.append(Fault(surface="scene", problem=what, count=0, first_items=(), outcome="error", hint=hint))
        return tuple(faults)


class HasScene(Protocol):
    """Any object that contains a scene, such as a `BuiltKnee`."""

    @property
    def scene(self) -> Scene:
        """Scene with the closed surfaces of the object."""


def resolve_scene(subject: Scene | HasScene) -> Scene:
    """Return the scene of an object, or return a scene unchanged.

    Parameters
    ----------
    subject : Scene or HasScene
        Scene, or an object that contains a scene, such as a `BuiltKnee`.

    Returns
    -------
    Scene
        Scene with all closed surfaces.

    Raises
    ------
    InputError
        If `subject` is neither a scene nor an object that contains a scene.
    """
    scene = subject if isinstance(subject, Scene) else getattr(subject, "scene", None)
    if not isinstance(scene, Scene):
        raise InputError(f"scene must be a Scene or a built knee, got {reprlib.repr(subject)}: use build(knee)")
    return scene


def require_traceable(scene: Scene) -> None:
    """Raise an error if ray casting of a scene is impossible, and warn about every repaired mesh.

    Parameters
    ----------
    scene : Scene
        Scene to check.

    Raises
    ------
    InputError
        If a fault cannot be repaired. The message contains the name of each surface, and the number and the first
        indices of the faulty faces, edges or vertices.

    Warns
    -----
    MeshNotice
        For every repaired mesh.
    """
    faults = scene.faults
    errors = [str(fault) for fault in faults if fault.outcome == "error"]
    if errors:
        raise InputError("; ".join(errors))
    for fault in faults:
        if fault.outcome == "repaired":
            warnings.warn(str(fault), MeshNotice, stacklevel=3)


def _require_size_range(size_mm: tuple[float, float]) -> tuple[float, float]:
    """Validate the smallest and the largest extent, in mm, and return both values as floats."""
    if not isinstance(size_mm, tuple | list | np.ndarray) or len(size_mm) != 2:
        raise InputError(f"scene: size_mm must be the smallest and the largest extent in mm, got {size_mm!r}")
    low, high = size_mm
    require_in_range("scene: size_mm[1]", high, 0, math.inf, "mm")
    require_in_range("scene: size_mm[0]", low, 0, high, "mm")
    return float(low), float(high)


def _suggest_unit(across_mm: float, low: float, high: float) -> str:
    """Return a hint that names a mesh unit in which the extent of a scene would be plausible."""
    for unit, factor in (("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4), ("micrometres", 0.001)):
        if low <= across_mm * factor <= high:
            return f" (if the mesh is in {unit}, use mesh.apply_scale({factor:g}))"
    return ""
