"""A closed mesh up to a height."""

import numpy as np

from ..core.checks import Array
from .mesh import Indices, Mesh


def up_to(mesh: Mesh, up: int, end_mm: float) -> Mesh:
    """What of a closed mesh is below a height (up = 1) or above it (-1), closed there by a fan.

    The section must be one outline all of which is seen from its middle, as a shaft's is. A mesh that ends before it
    is given back as it is.
    """
    within = up * mesh.vertices[:, 2] <= up * end_mm
    count = within[mesh.faces].sum(axis=1)
    crossed = (count == 1) | (count == 2)
    if not crossed.any():
        return mesh
    # Turned so that the first corner is alone on its side.
    cut = mesh.faces[crossed]
    first = (within[cut] == (count[crossed] == 1)[:, None]).argmax(axis=1)
    one, two, three = np.take_along_axis(cut, (first[:, None] + np.arange(3)) % 3, axis=1).T
    vertices, after, before = _with_crossings(mesh.vertices, one, two, three, end_mm)
    alone = within[one]
    faces = (
        mesh.faces[count == 3],
        np.column_stack((one, after, before))[alone],
        np.column_stack((after, two, three))[~alone],
        np.column_stack((after, three, before))[~alone],
        np.column_stack((np.where(alone, before, after), np.where(alone, after, before), np.full(len(cut), -1))),
    )
    middle = [*vertices[len(mesh.vertices) :, :2].mean(axis=0), end_mm]
    vertices = np.vstack((vertices, middle))
    used, number = np.unique(np.vstack(faces) % len(vertices), return_inverse=True)
    return Mesh(vertices[used], number.reshape(-1, 3))


def _with_crossings(
    vertices: Array, one: Indices, two: Indices, three: Indices, end_mm: float
) -> tuple[Array, Indices, Indices]:
    """Vertices with those where sides one-two and three-one cross a height, and their numbers, (n,) each."""
    sides = np.sort(np.concatenate((np.column_stack((one, two)), np.column_stack((three, one)))), axis=1)
    key, number = np.unique(sides @ [len(vertices), 1], return_inverse=True)
    start, end = (vertices[ends] for ends in divmod(key, len(vertices)))
    share = (end_mm - start[:, 2]) / (end[:, 2] - start[:, 2])
    crossings = start + share[:, None] * (end - start)
    crossings[:, 2] = end_mm
    after, before = (number.reshape(-1) + len(vertices)).reshape(2, -1)
    return np.vstack((vertices, crossings)), after, before
