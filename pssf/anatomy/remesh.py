"""Meshes of solids that lie on the level set of a field: smoothed over it, refined where it bends, free of folds."""

from collections.abc import Callable, Sequence

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array

from ..core.checks import Array
from ..geometry.mesh import Indices, Mesh
from .implicit import Field, lengths, project_to_surface, squares, with_gradient
from .solids import dilate_rings, mesh_of, solid_of, split_where

Choice = Callable[[Array], NDArray[np.bool_]]

# Of a whole bone: rounds of smoothing its mesh, rounds of splitting edges where it bends, and where its shaft begins.
_ROUNDS, _SPLITS, _SHAFT_FROM_MM = 6, 4, 70.0
# Rings of triangles about what may move that a fold may take room from.
_BORDER = 8
# Shafts are cut off before this height. Of laying folds flat: starts, turns of each, and smoothings in a turn.
_USED_MM, _STARTS, _TURNS, _FLATTENINGS = 200.0, 5, 5, 10
# Of a tip: what is about it, how far middles of edges may be off there, splits, and what may be cut off it.
_TIP_MM, _TIP_TOLERANCE_MM, _TIP_SPLITS, _CUT_MM = 4.0, 0.02, 3, 1e-4


def refined(solid: Manifold, edge_mm: float, shaft_from_mm: float) -> Manifold:
    """The solid with edges of at most `edge_mm`, and four times that along the shaft, beyond a distance from z = 0."""

    def pressed(factor: float) -> Callable[[Array], Array]:
        def move(points: Array) -> Array:
            places = np.array(points)
            beyond = np.maximum(np.abs(places[:, 2]) - shaft_from_mm, 0.0)
            places[:, 2] += np.sign(places[:, 2]) * beyond * (factor - 1)
            return places

        return move

    short = solid.simplify(0.02).warp_batch(pressed(0.25))
    return short.refine_to_length(edge_mm).warp_batch(pressed(4.0))


def mesh_bone(rough: Manifold, field: Field, edge_mm: float, tolerances_mm: Sequence[float]) -> list[Manifold]:
    """A bone by CSG as its field has it: evenly meshed, and finer where it bends; once for each tolerance.

    edge_mm        longest edge, away from the shaft
    tolerances_mm  how far middles of edges may be off the field
    """
    even = solid_of(*laplacian_smooth(mesh_of(refined(rough, edge_mm, _SHAFT_FROM_MM)), field, _ROUNDS), "smoothed")
    # A tenth of the triangles, in flat places, is not needed.
    return [
        refine_to_tolerance(even, field, tolerance_mm, _SPLITS).simplify(0.4 * tolerance_mm)
        for tolerance_mm in tolerances_mm
    ]


def laplacian_smooth(
    mesh: Mesh,
    field: Field,
    rounds: int,
    near: Choice | None = None,
    tips: Sequence[Array] = (),
) -> Mesh:
    """A closed surface settled on a field, its vertices spread evenly over it, free of slivers from creases of CSG.

    near  which vertices may move at all: (n, 3) -> (n,) bool; all of them if None
    tips  points (3,) of the field's surface, mm, that a coarse mesh would cut off
    """
    all_places, all_faces = np.array(mesh.vertices), np.asarray(mesh.faces)
    may_move = np.ones(len(all_places), np.bool_) if near is None else near(all_places)
    # A fold at the border of what may move needs room beyond it. Nothing else is touched, and most of a bone is not.
    with_border = dilate_rings(may_move, all_faces, _BORDER)
    touched = with_border[all_faces].any(axis=1)
    used, numbers = np.unique(all_faces[touched], return_inverse=True)
    places, free = all_places[used], may_move[used]
    faces: Indices = numbers.reshape(-1, 3).astype(np.int64)
    neighbour_mean_matrix = neighbour_means(faces, len(places))[free]
    places[free] = project_to_surface(places[free], field, None, 5)
    for _ in range(rounds):
        places[free] = project_to_surface((places[free] + neighbour_mean_matrix @ places) / 2, field, None, 2)
    places, faces = _fix_inverted_faces(places, faces, with_border[used], field, free)
    places, faces = _with_tips(places, faces, field, tips)
    all_places[used] = places[: len(used)]
    added = np.arange(len(places) - len(used)) + len(all_places)
    number = np.concatenate((used, added))
    faces = np.vstack((all_faces[~touched], number[faces]))
    return Mesh(np.vstack((all_places, places[len(used) :])), faces)


def neighbour_means(faces: Indices, count: int) -> csr_array:
    """(count, count)  takes values at vertices to their means over those that share an edge with each

    faces  (m, 3)  vertex numbers
    """
    ends = np.vstack((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    beside = coo_array((np.ones(len(ends)), ends.T), shape=(count, count)).tocsr()
    return csr_array(diags_array(1.0 / beside.sum(axis=1)) @ beside)


def _with_tips(places: Array, faces: Indices, field: Field, tips: Sequence[Array]) -> tuple[Array, Indices]:
    """Places and faces with tips of the field's surface, where they cut them off.

    Edges about them are split, then the triangle below each gets a vertex there.
    """
    tips = [tip for tip in tips if _below(places, faces, tip)[1] >= _CUT_MM]
    if tips:

        def about(points: Array) -> NDArray[np.bool_]:
            return np.asarray(np.any([_within(tip, points) for tip in tips], axis=0))

        places, faces = _split_where_off(places, faces, field, _TIP_TOLERANCE_MM, _TIP_SPLITS, about)
    for tip in tips:
        below, away = _below(places, faces, tip)
        if away >= _CUT_MM:
            one, two, three = faces[below]
            new = len(places)
            pieces = [[one, two, new], [two, three, new], [three, one, new]]
            places, faces = np.vstack((places, tip)), np.vstack((np.delete(faces, below, axis=0), pieces))
    return places, faces


def _below(places: Array, faces: Indices, tip: Array) -> tuple[int, float]:
    """The triangle that is nearest to a tip, and how far away it is."""
    one, two, three = places[faces.T]
    about = np.flatnonzero(_within(tip, (one + two + three) / 3))
    away = _distances(places[faces[about]], tip)
    return int(about[away.argmin()]), float(away.min())


def _distances(triangles: Array, point: Array) -> Array:
    """(n,)  of a point (3,) from triangles (n, 3, 3), mm"""
    # trimesh has this too, and takes a quarter of a second to be loaded.
    sides, away = np.roll(triangles, -1, axis=1) - triangles, point - triangles
    along = np.clip((away * sides).sum(axis=2) / np.maximum((sides**2).sum(axis=2), 1e-300), 0.0, 1.0)
    beside = np.sqrt(((away - along[..., None] * sides) ** 2).sum(axis=2)).min(axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    above = ((np.cross(sides, away) * normals[:, None]).sum(axis=2) > 0).all(axis=1)
    height = np.abs((away[:, 0] * normals).sum(axis=1)) / np.maximum(lengths(normals), 1e-300)
    return np.where(above, height, beside)


def _within(tip: Array, points: Array) -> NDArray[np.bool_]:
    return np.asarray(squares(points - tip) < _TIP_MM**2)


def _fix_inverted_faces(
    places: Array, faces: Indices, free: NDArray[np.bool_], field: Field, moved: NDArray[np.bool_] | None = None
) -> tuple[Array, Indices]:
    """Places and faces with triangles that face inwards laid flat: what is around them is spread evenly once more.

    First slivers get another edge, where that is enough. A patch that stays folded is widened turn by turn, since a
    narrow one about a tip has no room to turn; where that only drives the folds outwards, the places with fewest of
    them are taken up again with a wider patch. Slivers that are left get another edge.

    free   which vertices may move, (n,)
    moved  which have, so that their triangles may face inwards, (n,); those that may if None
    """
    best, faces, fewest, used = _without_slivers(places, faces, free, field, moved)
    if not len(fewest):
        return best, faces
    neighbour_mean_matrix = neighbour_means(faces, len(places))
    for rings in range(1, 1 + _STARTS):
        laid, folded = best.copy(), fewest
        for turn in range(_TURNS):
            if not len(folded):
                return best, faces
            around = np.zeros(len(places), np.bool_)
            around[folded] = True
            around = free & dilate_rings(around, faces, rings + turn)
            laid[around] = _spread(laid, around, neighbour_mean_matrix[around], field)
            suspect = used[around[used].any(axis=1)]  # the others have been found to face outwards, and stay
            folded = suspect[_face_inwards(laid[suspect], field)]
            if len(folded) < len(fewest):
                best, fewest = laid.copy(), folded
    return _without_slivers(best, faces, free, field)[:2]


def _without_slivers(
    places: Array, faces: Indices, free: NDArray[np.bool_], field: Field, moved: NDArray[np.bool_] | None = None
) -> tuple[Array, Indices, Indices, Indices]:
    """Places and faces with folded slivers joined to their neighbours by other edges, where that helps.

    And of those faces of which a corner may move: the ones that are still folded, and all.
    """
    used = _movable(places, faces, free)
    suspect = used if moved is None else used[moved[used].any(axis=1)]
    folded = suspect[_face_inwards(places[suspect], field)]
    if not len(folded):
        return places, faces, folded, used
    faces, folded = _flipped(places, faces, folded, field)
    # A corner of three triangles is moved to the middle of their other corners, where none of the three can be folded.
    lonely = [corner for corner in np.unique(folded) if free[corner] and (faces == corner).sum() == 3]
    places = places.copy()
    for corner in lonely:
        others = np.setdiff1d(faces[(faces == corner).any(axis=1)], corner)
        places[corner] = project_to_surface(places[others].mean(axis=0, keepdims=True), field, None, 2)[0]
    return places, faces, folded[_face_inwards(places[folded], field)], _movable(places, faces, free)


def _movable(places: Array, faces: Indices, free: NDArray[np.bool_]) -> Indices:
    """Faces of which a corner may move, but for what is cut off shafts."""
    return faces[free[faces].any(axis=1) & (np.abs(places[faces, 2]) < _USED_MM).all(axis=1)]


def _flipped(places: Array, faces: Indices, folded: Indices, field: Field) -> tuple[Indices, Indices]:
    """The faces with folded ones (k, 3) and their neighbours across an edge joined the other way, where that helps.

    And those that stay folded.
    """
    all_faces, mended = faces.copy(), np.zeros(len(folded), np.bool_)
    # All that is looked for has a corner of a folded one.
    touched = np.zeros(len(places), np.bool_)
    touched[folded] = True
    about = touched[faces].any(axis=1)
    faces = faces[about]
    for number, corners in enumerate(folded):
        still = np.flatnonzero((faces == corners).all(axis=1))
        mended[number] = not len(still)  # joined another way as a neighbour
        if mended[number]:
            continue
        mine = int(still[0])
        for turn in range(3):
            one, two, mine_far = np.roll(corners, -turn)
            both = np.flatnonzero((faces == one).any(axis=1) & (faces == two).any(axis=1))
            if len(both) < 2:
                continue  # an edge of the touched part, whose other side is not here
            across = int(both[both != mine][0])
            its_far = next(corner for corner in faces[across] if corner not in (one, two))
            pair = np.array([[one, its_far, mine_far], [its_far, two, mine_far]])
            joined = ((faces == its_far).any(axis=1) & (faces == mine_far).any(axis=1)).any()
            if not joined and not _face_inwards(places[pair], field).any():
                faces[[mine, across]], mended[number] = pair, True
                break
    all_faces[about] = faces
    return all_faces, folded[~mended]


def _spread(places: Array, around: NDArray[np.bool_], neighbour_mean_matrix: csr_array, field: Field) -> Array:
    """Those of the places that are around a fold, evenly spread over the field's surface"""
    laid = places.copy()
    for _ in range(_FLATTENINGS):
        laid[around] = project_to_surface(neighbour_mean_matrix @ laid, field, None, 1)
    return project_to_surface(laid[around], field, None, 5)


def _face_inwards(triangles: Array, field: Field) -> NDArray[np.bool_]:
    """(n,)  which of (n, 3, 3) corners are in the order of a triangle that faces inwards"""
    one, two, three = (triangles[:, k] for k in range(3))
    _, outward = with_gradient(field, (one + two + three) / 3)
    return np.asarray((np.cross(two - one, three - one) * outward).sum(axis=1) <= 0)


def refine_to_tolerance(solid: Manifold, field: Field, tolerance_mm: float, rounds: int) -> Manifold:
    """A solid settled on a field, with those edges split, up to so many times, whose middles are farther off."""
    mesh = mesh_of(solid)
    places, faces = np.array(mesh.vertices), np.asarray(mesh.faces)
    places, faces = _split_where_off(places, faces, field, tolerance_mm, rounds)
    places, faces = _fix_inverted_faces(places, faces, np.ones(len(places), np.bool_), field)
    return solid_of(places, faces, "resolved")


def _split_where_off(
    places: Array, faces: Indices, field: Field, tolerance_mm: float, rounds: int, near: Choice | None = None
) -> tuple[Array, Indices]:
    """Places and faces with those edges split, up to so many times, whose middles are farther off the field.

    near  which vertices both ends of an edge must be among: (n, 3) -> (n,) bool; all of them if None
    """

    def off(places: Array, edges: Indices) -> tuple[Indices, Array]:
        middles = places[edges].mean(axis=1)
        settled = project_to_surface(middles, field, None, 3)
        away = np.linalg.norm(settled - middles, axis=1) > tolerance_mm
        return edges[away], settled[away]

    return split_where(places, faces, rounds, off, near)
