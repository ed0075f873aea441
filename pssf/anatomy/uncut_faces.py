"""Faces away from a cut as they were: manifold3d turns edges of folded slivers of a whole mesh wherever it cuts it.

Of a mesh with such slivers a boolean moves the surface by micrometres, far from what was cut. These patches are put
back, where faces of the result that are none of the original's, on vertices of the original, have the same boundary as
faces of the original that are gone.
"""

import numpy as np

from ..geometry.mesh import Indices, Mesh
from ..geometry.topology import bodies


def with_uncut_faces(cut: Mesh, whole: Mesh) -> Mesh:
    """Put back the faces of a mesh that a boolean has turned the edges of away from the cut.

    cut    (n, 3) and (m, 3)  what is left of the mesh
    whole  (k, 3) and (l, 3)  as it was
    """
    places, number = np.unique(np.vstack((whole.vertices, cut.vertices)), axis=0, return_inverse=True)
    own = number.ravel()[len(whole.vertices) :]
    before, after = number.ravel()[whole.faces], own[cut.faces]
    of_whole = np.zeros(len(places), np.bool_)
    of_whole[before] = True
    old, new = (_keys(faces, len(places)) for faces in (before, after))
    gone = before[~np.isin(old, new)]
    turned = np.flatnonzero(~np.isin(new, old) & of_whole[after].all(axis=1))
    originals = {_boundary(gone[patch]): gone[patch] for patch in _patches(gone, len(places))}
    keep, put_back = np.ones(len(after), np.bool_), []
    for patch in _patches(after[turned], len(places)):
        numbers = turned[patch]
        original = originals.get(_boundary(after[numbers]))
        if original is not None:
            keep[numbers] = False
            put_back.append(original)
    if not put_back:
        return cut
    restored = np.vstack(put_back)
    lost = np.setdiff1d(restored, own)  # vertices within a patch, of which the cut mesh has none
    vertex = np.empty(len(places), np.int64)
    vertex[own], vertex[lost] = np.arange(len(own)), len(own) + np.arange(len(lost))
    return Mesh(np.vstack((cut.vertices, places[lost])), np.vstack((cut.faces[keep], vertex[restored])))


def _keys(faces: Indices, count: int) -> Indices:
    """(m,)  a number for each face of vertices below a count, the same whichever of its corners is the first"""
    start = faces.argmin(axis=1)
    first, second, third = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1).T.astype(np.int64)
    return np.asarray((first * count + second) * count + third)


def _patches(faces: Indices, count: int) -> list[Indices]:
    """Numbers of the faces of each part that hangs together."""
    if not len(faces):
        return []
    body, _ = bodies(faces.astype(np.int32), count)
    owner = body[faces[:, 0]]
    order = np.argsort(owner, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(owner[order])) + 1)


def _boundary(faces: Indices) -> frozenset[tuple[int, int]]:
    """Directed edges of faces whose reverse is of none of them."""
    edges = {(int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3)}
    return frozenset(edge for edge in edges if edge[::-1] not in edges)
