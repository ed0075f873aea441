"""Repair after Boolean operations: restore the faces that a cut should not have changed.

In a mesh with folded slivers, a Boolean operation of manifold3d also flips edges far from the cut. These flips move the
surface by micrometres. A patch of new faces is replaced if all its vertices are original vertices and its boundary
equals the boundary of a patch of removed faces.
"""

import numpy as np

from ...geometry.mesh import Indices, Mesh
from ...geometry.mesh_topology import label_bodies


def restore_uncut_faces(cut: Mesh, whole: Mesh) -> Mesh:
    """Far from the cut, restore the original faces where a Boolean operation has flipped edges.

    Parameters
    ----------
    cut : Mesh
        Mesh after the cut: vertices (n, 3) in mm, faces (m, 3).
    whole : Mesh
        Mesh before the cut: vertices (k, 3) in mm, faces (l, 3).

    Returns
    -------
    Mesh
        Cut mesh with restored original faces, or unchanged `cut` if no face needs to be restored.
    """
    places, number = np.unique(np.vstack((whole.vertices, cut.vertices)), axis=0, return_inverse=True)
    own = number.ravel()[len(whole.vertices) :]
    before, after = number.ravel()[whole.faces], own[cut.faces]
    of_whole = np.zeros(len(places), np.bool_)
    of_whole[before] = True
    old, new = (_compute_face_keys(faces, len(places)) for faces in (before, after))
    gone = before[~np.isin(old, new)]
    turned = np.flatnonzero(~np.isin(new, old) & of_whole[after].all(axis=1))
    originals = {_find_boundary_edges(gone[patch]): gone[patch] for patch in _split_into_patches(gone, len(places))}
    keep, put_back = np.ones(len(after), np.bool_), []
    for patch in _split_into_patches(after[turned], len(places)):
        numbers = turned[patch]
        original = originals.get(_find_boundary_edges(after[numbers]))
        if original is not None:
            keep[numbers] = False
            put_back.append(original)
    if not put_back:
        return cut
    restored = np.vstack(put_back)
    lost = np.setdiff1d(restored, own)  # Vertices inside restored patches that the cut mesh lacks.
    vertex = np.empty(len(places), np.int64)
    vertex[own], vertex[lost] = np.arange(len(own)), len(own) + np.arange(len(lost))
    return Mesh(np.vstack((cut.vertices, places[lost])), np.vstack((cut.faces[keep], vertex[restored])))


def _compute_face_keys(faces: Indices, count: int) -> Indices:
    """Compute keys (m,) of faces. A key does not depend on which corner of the face comes first.

    `faces` (m, 3) are vertex numbers below `count`.
    """
    start = faces.argmin(axis=1)
    first, second, third = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1).T.astype(np.int64)
    return np.asarray((first * count + second) * count + third)


def _split_into_patches(faces: Indices, count: int) -> list[Indices]:
    """Split faces (m, 3) into connected patches and return the face numbers of each patch."""
    if not len(faces):
        return []
    body, _ = label_bodies(faces.astype(np.int32), count)
    owner = body[faces[:, 0]]
    order = np.argsort(owner, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(owner[order])) + 1)


def _find_boundary_edges(faces: Indices) -> frozenset[tuple[int, int]]:
    """Find the directed edges of faces (m, 3) whose reversed edge does not belong to these faces."""
    edges = {(int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3)}
    return frozenset(edge for edge in edges if edge[::-1] not in edges)
