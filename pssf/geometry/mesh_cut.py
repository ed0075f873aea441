"""Cutting of a closed mesh at a given height, for example of a bone at its shaft."""

import numpy as np

from ..core.checks import Array
from .mesh import Indices, Mesh


def cut_mesh_at_height(mesh: Mesh, direction: int, height_mm: float) -> Mesh:
    """Cut a closed mesh at a given height, and close the cut surface with a triangle fan.

    Parameters
    ----------
    mesh : Mesh
        Closed mesh, in mm. The cross-section at the cut must be a single star-shaped outline, such as that of a bone
        shaft.
    direction : int
        +1 to retain the mesh below the cut, -1 to retain the mesh above the cut.
    height_mm : float
        Height of the cut along z, in mm.

    Returns
    -------
    Mesh
        Closed mesh after the cut. A mesh that does not reach the cutting height is returned unchanged.
    """
    # Manifold.trim_by_plane is not used, because it takes 79 ms instead of 6 ms and changes vertices and faces.
    within = direction * mesh.vertices[:, 2] <= direction * height_mm
    count = within[mesh.faces].sum(axis=1)
    crossed = (count == 1) | (count == 2)
    if not crossed.any():
        return mesh
    # The corners of each cut face are rotated, so that the first corner is on one side of the cutting plane and the
    # other two corners are on the opposite side.
    cut = mesh.faces[crossed]
    first = (within[cut] == (count[crossed] == 1)[:, None]).argmax(axis=1)
    one, two, three = np.take_along_axis(cut, (first[:, None] + np.arange(3)) % 3, axis=1).T
    vertices, after, before = _add_crossing_vertices(mesh.vertices, one, two, three, height_mm)
    alone = within[one]
    faces = (
        mesh.faces[count == 3],
        np.column_stack((one, after, before))[alone],
        np.column_stack((after, two, three))[~alone],
        np.column_stack((after, three, before))[~alone],
        np.column_stack((np.where(alone, before, after), np.where(alone, after, before), np.full(len(cut), -1))),
    )
    middle = [*vertices[len(mesh.vertices) :, :2].mean(axis=0), height_mm]
    vertices = np.vstack((vertices, middle))
    used, number = np.unique(np.vstack(faces) % len(vertices), return_inverse=True)
    return Mesh(vertices[used], number.reshape(-1, 3))


def _add_crossing_vertices(
    vertices: Array, one: Indices, two: Indices, three: Indices, height_mm: float
) -> tuple[Array, Indices, Indices]:
    """Append the vertices at which the face edges one-two and three-one cross a given height.

    The return values are all vertices, and the indices (n,) of the new vertices on each of the two edges.
    """
    sides = np.sort(np.concatenate((np.column_stack((one, two)), np.column_stack((three, one)))), axis=1)
    key, number = np.unique(sides @ [len(vertices), 1], return_inverse=True)
    start, end = (vertices[ends] for ends in divmod(key, len(vertices)))
    share = (height_mm - start[:, 2]) / (end[:, 2] - start[:, 2])
    crossings = start + share[:, None] * (end - start)
    crossings[:, 2] = height_mm
    after, before = (number.reshape(-1) + len(vertices)).reshape(2, -1)
    return np.vstack((vertices, crossings)), after, before
