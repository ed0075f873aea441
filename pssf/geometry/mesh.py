"""Triangle meshes as plain arrays; trimesh is imported only when a trimesh object is requested."""

import sys
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array

if TYPE_CHECKING:
    import trimesh


Indices = NDArray[np.integer[Any]]


class Mesh(NamedTuple):
    """Triangle mesh of vertices and faces.

    Attributes
    ----------
    vertices : (n, 3) float64 array
        Vertices, in mm.
    faces : (m, 3) integer array
        Vertex indices of each triangle, in the order that makes the normal point outward.
    """

    vertices: Array
    faces: Indices

    def as_trimesh(self) -> "trimesh.Trimesh":
        """Convert the mesh to a trimesh object.

        Returns
        -------
        trimesh.Trimesh
            Mesh with the same vertices and faces.
        """
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def is_mesh(thing: Any) -> bool:
    """Report whether an object is a Mesh or a trimesh.Trimesh.

    Parameters
    ----------
    thing : object
        Object to test.

    Returns
    -------
    bool
        True for a mesh of either type.
    """
    # A trimesh object can exist only if trimesh is already imported, so this function does not import it.
    loaded = sys.modules.get("trimesh")
    return isinstance(thing, Mesh) or (loaded is not None and isinstance(thing, loaded.Trimesh))


class MeshField:
    """Descriptor of a dataclass field that accepts a Mesh or a trimesh.Trimesh and returns a trimesh.Trimesh."""

    def __get__(self, holder: Any, owner: Any = None) -> "trimesh.Trimesh":
        if holder is None:
            raise AttributeError("mesh")  # This error makes the dataclass treat the field as one without a default.
        if isinstance(holder.__dict__["_mesh"], Mesh):
            holder.__dict__["_mesh"] = holder.__dict__["_mesh"].as_trimesh()
        mesh: trimesh.Trimesh = holder.__dict__["_mesh"]
        return mesh

    def __set__(self, holder: Any, mesh: Any) -> None:
        holder.__dict__["_mesh"] = mesh

    @staticmethod
    def mesh_arrays(holder: Any) -> Mesh:
        """Return the mesh of a dataclass instance as arrays, without importing trimesh.

        Parameters
        ----------
        holder : object
            Instance of a dataclass with a `MeshField`.

        Returns
        -------
        Mesh
            Mesh with vertices in mm.
        """
        held = holder.__dict__["_mesh"]
        return held if isinstance(held, Mesh) else Mesh(held.vertices, held.faces)
