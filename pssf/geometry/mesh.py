"""Mesh: vertices and faces, for what this package makes; trimesh is loaded when somebody asks for one of its own."""

import sys
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array

if TYPE_CHECKING:
    import trimesh


Indices = NDArray[np.integer[Any]]


class Mesh(NamedTuple):
    """Triangles.

    vertices  (n, 3)  mm
    faces     (m, 3)  vertex numbers, outward
    """

    vertices: Array
    faces: Indices

    def as_trimesh(self) -> "trimesh.Trimesh":
        """The same as a trimesh.Trimesh."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def is_mesh(thing: Any) -> bool:
    """Whether something is a Mesh or a trimesh.Trimesh."""
    # Whoever has one has loaded trimesh.
    loaded = sys.modules.get("trimesh")
    return isinstance(thing, Mesh) or (loaded is not None and isinstance(thing, loaded.Trimesh))


class MeshField:
    """A field of a frozen dataclass that takes either, and gives a trimesh.Trimesh when it is read."""

    def __get__(self, holder: Any, owner: Any = None) -> "trimesh.Trimesh":
        if holder is None:
            raise AttributeError("mesh")  # so that the field has no default
        if isinstance(holder.__dict__["_mesh"], Mesh):
            holder.__dict__["_mesh"] = holder.__dict__["_mesh"].as_trimesh()
        mesh: trimesh.Trimesh = holder.__dict__["_mesh"]
        return mesh

    def __set__(self, holder: Any, mesh: Any) -> None:
        holder.__dict__["_mesh"] = mesh

    @staticmethod
    def arrays(holder: Any) -> Mesh:
        """Vertices and faces as they are held."""
        held = holder.__dict__["_mesh"]
        return held if isinstance(held, Mesh) else Mesh(held.vertices, held.faces)
