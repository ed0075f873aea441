"""Remeshing: smooth and refine meshes on the zero level set of a distance field, and remove inverted faces."""

from collections.abc import Callable, Sequence

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array

from ...core.checks import Array
from ...geometry.mesh import Indices, Mesh
from .implicit_shapes import (
    ScalarField,
    evaluate_with_gradient,
    lengths,
    project_to_surface,
    squared_lengths,
)
from .solids import (
    build_solid,
    dilate_rings,
    extract_mesh,
    split_selected_edges,
)

# A vertex selector maps vertices (n, 3), in mm, to booleans (n,).
VertexSelector = Callable[[Array], NDArray[np.bool_]]

# Number of smoothing iterations for the mesh of an entire bone.
_ROUNDS = 6
# Largest number of times that the edges of an entire bone are split.
_SPLITS = 4
# Distance from z = 0 at which the shaft begins in the mesh of an entire bone, in mm.
_SHAFT_FROM_MM = 70.0
# Number of vertex rings around the movable vertices in which vertices may also move while inverted faces are flattened.
_BORDER_RINGS = 8
# Largest distance from z = 0 at which faces are repaired, mm. Shafts are cut off at a smaller distance.
_USED_MM = 200.0
# Number of attempts to flatten inverted faces. Each attempt uses a wider neighbourhood.
_STARTS = 5
# Number of rounds per attempt to flatten inverted faces.
_TURNS = 5
# Number of smoothing iterations per round while inverted faces are flattened.
_FLATTENINGS = 10
# Radius of the neighbourhood of an osteophyte tip, in mm.
_TIP_MM = 4.0
# Largest distance of an edge midpoint from the field surface near an osteophyte tip, in mm.
_TIP_TOLERANCE_MM = 0.02
# Largest number of times that edges near an osteophyte tip are split.
_TIP_SPLITS = 3
# Smallest distance between an osteophyte tip and the nearest triangle at which the tip is inserted as a vertex, in mm.
_CUT_MM = 1e-4


def refine_bone(solid: Manifold, edge_mm: float, shaft_from_mm: float) -> Manifold:
    """Refine a solid to a maximum edge length; in the shaft, edges along z may be four times as long.

    Parameters
    ----------
    solid : Manifold
        Solid with its long axis along z, in mm.
    edge_mm : float
        Maximum edge length at the joint end, in mm.
    shaft_from_mm : float
        Distance from z = 0 at which the shaft begins, in mm.

    Returns
    -------
    Manifold
        Refined solid.
    """

    def pressed(factor: float) -> Callable[[Array], Array]:
        def move(points: Array) -> Array:
            places = np.array(points)
            beyond = np.maximum(np.abs(places[:, 2]) - shaft_from_mm, 0.0)
            places[:, 2] += np.sign(places[:, 2]) * beyond * (factor - 1)
            return places

        return move

    short = solid.simplify(0.02).warp_batch(pressed(0.25))
    return short.refine_to_length(edge_mm).warp_batch(pressed(4.0))


def mesh_bone(
    csg_solid: Manifold, field: ScalarField, edge_mm: float, tolerances_mm: Sequence[float]
) -> list[Manifold]:
    """Mesh a bone from its distance field, once for each tolerance, with smaller triangles where curvature is high.

    Parameters
    ----------
    csg_solid : Manifold
        The same bone as a Boolean combination of solids, with sharp creases.
    field : callable
        Distance field of the bone. It maps points (n, 3), in mm, to signed distances (n,), in mm.
    edge_mm : float
        Maximum edge length away from the shaft, in mm.
    tolerances_mm : sequence of float
        Maximum distance of edge midpoints from the surface of the field, in mm.

    Returns
    -------
    list of Manifold
        One solid per tolerance, in the same order.

    Raises
    ------
    InputError
        If a mesh is not a valid solid.
    """
    even = build_solid(
        *laplacian_smooth(extract_mesh(refine_bone(csg_solid, edge_mm, _SHAFT_FROM_MM)), field, _ROUNDS),
        "smoothed bone",
    )
    # Simplification removes about a tenth of the triangles, all of which are in flat regions.
    return [
        refine_to_tolerance(even, field, tolerance_mm, _SPLITS).simplify(0.4 * tolerance_mm)
        for tolerance_mm in tolerances_mm
    ]


def laplacian_smooth(
    mesh: Mesh,
    field: ScalarField,
    rounds: int,
    select_movable: VertexSelector | None = None,
    tips: Sequence[Array] = (),
) -> Mesh:
    """Move a closed mesh onto a field surface, space its vertices evenly and remove slivers that CSG left.

    Parameters
    ----------
    mesh : Mesh
        Closed mesh near the field surface, with vertices (n, 3) in mm.
    field : callable
        Distance field. It maps points (n, 3), in mm, to signed distances (n,), in mm.
    rounds : int
        Number of smoothing iterations.
    select_movable : callable or None
        Function that maps vertices (n, 3), in mm, to booleans (n,): True where a vertex may move. None means that all
        vertices may move.
    tips : sequence of (3,) float64 array
        Points on the field surface that a coarse mesh would cut off, in mm. A vertex is inserted at each tip.

    Returns
    -------
    Mesh
        Smoothed mesh. The original vertices keep their order, and new vertices follow.
    """
    all_places, all_faces = np.array(mesh.vertices), np.asarray(mesh.faces)
    may_move = np.ones(len(all_places), np.bool_) if select_movable is None else select_movable(all_places)
    # Flattening inverted faces at the border also moves vertices beyond the border. Vertices farther away stay
    # unchanged.
    with_border = dilate_rings(may_move, all_faces, _BORDER_RINGS)
    touched = with_border[all_faces].any(axis=1)
    used, numbers = np.unique(all_faces[touched], return_inverse=True)
    places, free = all_places[used], may_move[used]
    faces: Indices = numbers.reshape(-1, 3).astype(np.int64)
    neighbour_mean_matrix = build_neighbour_averaging(faces, len(places))[free]
    places[free] = project_to_surface(places[free], field, None, 5)
    for _ in range(rounds):
        places[free] = project_to_surface((places[free] + neighbour_mean_matrix @ places) / 2, field, None, 2)
    places, faces = _fix_inverted_faces(places, faces, with_border[used], field, free)
    places, faces = _insert_tips(places, faces, field, tips)
    all_places[used] = places[: len(used)]
    added = np.arange(len(places) - len(used)) + len(all_places)
    number = np.concatenate((used, added))
    faces = np.vstack((all_faces[~touched], number[faces]))
    return Mesh(np.vstack((all_places, places[len(used) :])), faces)


def build_neighbour_averaging(faces: Indices, count: int) -> csr_array:
    """Build the sparse matrix that averages vertex values over neighbouring vertices.

    Parameters
    ----------
    faces : (m, 3) int array, vertex numbers
        Triangles.
    count : int
        Number of vertices.

    Returns
    -------
    (count, count) csr_array
        Matrix that maps vertex values to the mean value over the vertices that are connected to each vertex by an edge.
    """
    ends = np.vstack((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    beside = coo_array((np.ones(len(ends)), ends.T), shape=(count, count)).tocsr()
    return csr_array(diags_array(1.0 / beside.sum(axis=1)) @ beside)


def _insert_tips(places: Array, faces: Indices, field: ScalarField, tips: Sequence[Array]) -> tuple[Array, Indices]:
    """Insert tips that the mesh cuts off as vertices, and return the new vertices and faces.

    Edges near these tips are split first. The triangle below each tip then gets a vertex at the tip.
    """
    tips = [tip for tip in tips if _find_nearest_face(places, faces, tip)[1] >= _CUT_MM]
    if tips:

        def about(points: Array) -> NDArray[np.bool_]:
            return np.asarray(np.any([_is_near_tip(tip, points) for tip in tips], axis=0))

        places, faces = _split_edges_off_surface(places, faces, field, _TIP_TOLERANCE_MM, _TIP_SPLITS, about)
    for tip in tips:
        below, away = _find_nearest_face(places, faces, tip)
        if away >= _CUT_MM:
            one, two, three = faces[below]
            new = len(places)
            pieces = [[one, two, new], [two, three, new], [three, one, new]]
            places, faces = np.vstack((places, tip)), np.vstack((np.delete(faces, below, axis=0), pieces))
    return places, faces


def _find_nearest_face(places: Array, faces: Indices, tip: Array) -> tuple[int, float]:
    """Find the triangle nearest to a tip (3,), and return its number and its distance in mm."""
    one, two, three = places[faces.T]
    about = np.flatnonzero(_is_near_tip(tip, (one + two + three) / 3))
    away = _compute_triangle_distances_mm(places[faces[about]], tip)
    return int(about[away.argmin()]), float(away.min())


def _compute_triangle_distances_mm(triangles: Array, point: Array) -> Array:
    """Compute the distances (n,) of a point (3,) from triangles (n, 3, 3), mm."""
    # trimesh provides the same function, but importing trimesh takes a quarter of a second.
    sides, away = np.roll(triangles, -1, axis=1) - triangles, point - triangles
    along = np.clip((away * sides).sum(axis=2) / np.maximum((sides**2).sum(axis=2), 1e-300), 0.0, 1.0)
    beside = np.sqrt(((away - along[..., None] * sides) ** 2).sum(axis=2)).min(axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    above = ((np.cross(sides, away) * normals[:, None]).sum(axis=2) > 0).all(axis=1)
    height = np.abs((away[:, 0] * normals).sum(axis=1)) / np.maximum(lengths(normals), 1e-300)
    return np.where(above, height, beside)


def _is_near_tip(tip: Array, points: Array) -> NDArray[np.bool_]:
    """Select the points (n, 3) within 4 mm of a tip (3,)."""
    return np.asarray(squared_lengths(points - tip) < _TIP_MM**2)


def _fix_inverted_faces(
    places: Array,
    faces: Indices,
    movable: NDArray[np.bool_],
    field: ScalarField,
    has_moved: NDArray[np.bool_] | None = None,
) -> tuple[Array, Indices]:
    """Flatten faces that point inwards: flip edges of slivers, then smooth around the remaining inverted faces.

    Each attempt smooths a patch around the inverted faces and widens the patch in every round. Vertices in a narrow
    patch around a tip have no space to move. The vertices with the fewest inverted faces are therefore kept, and the
    next attempt starts from these vertices with a wider patch. Finally, edges are flipped again. `movable` (n,) marks
    vertices that may move. `has_moved` (n,) marks vertices whose faces may be inverted; None means the movable
    vertices.
    """
    best, faces, fewest, used = _repair_slivers(places, faces, movable, field, has_moved)
    if not len(fewest):
        return best, faces
    neighbour_mean_matrix = build_neighbour_averaging(faces, len(places))
    for rings in range(1, 1 + _STARTS):
        laid, folded = best.copy(), fewest
        for turn in range(_TURNS):
            if not len(folded):
                return best, faces
            around = np.zeros(len(places), np.bool_)
            around[folded] = True
            around = movable & dilate_rings(around, faces, rings + turn)
            laid[around] = _relax_around_fold(laid, around, neighbour_mean_matrix[around], field)
            # Faces without a moved vertex still point outwards, so only the other faces are tested.
            suspect = used[around[used].any(axis=1)]
            folded = suspect[_is_facing_inwards(laid[suspect], field)]
            if len(folded) < len(fewest):
                best, fewest = laid.copy(), folded
    return _repair_slivers(best, faces, movable, field)[:2]


def _repair_slivers(
    places: Array,
    faces: Indices,
    movable: NDArray[np.bool_],
    field: ScalarField,
    has_moved: NDArray[np.bool_] | None = None,
) -> tuple[Array, Indices, Indices, Indices]:
    """Flip edges of inverted slivers, and return vertices, all faces, remaining inverted faces and candidate faces.

    Inverted faces and candidate faces have at least one movable corner.
    """
    used = _select_movable_faces(places, faces, movable)
    suspect = used if has_moved is None else used[has_moved[used].any(axis=1)]
    folded = suspect[_is_facing_inwards(places[suspect], field)]
    if not len(folded):
        return places, faces, folded, used
    faces, folded = _flip_edges(places, faces, folded, field)
    # A corner that belongs to only three triangles moves to the mean of the neighbouring corners, where none of the
    # three triangles can be inverted.
    lonely = [corner for corner in np.unique(folded) if movable[corner] and (faces == corner).sum() == 3]
    places = places.copy()
    for corner in lonely:
        others = np.setdiff1d(faces[(faces == corner).any(axis=1)], corner)
        places[corner] = project_to_surface(places[others].mean(axis=0, keepdims=True), field, None, 2)[0]
    return (
        places,
        faces,
        folded[_is_facing_inwards(places[folded], field)],
        _select_movable_faces(places, faces, movable),
    )


def _select_movable_faces(places: Array, faces: Indices, movable: NDArray[np.bool_]) -> Indices:
    """Select the faces with a movable corner, except those on the portion of the shaft that is later cut off."""
    return faces[movable[faces].any(axis=1) & (np.abs(places[faces, 2]) < _USED_MM).all(axis=1)]


def _flip_edges(places: Array, faces: Indices, folded: Indices, field: ScalarField) -> tuple[Indices, Indices]:
    """Flip edges between inverted faces (k, 3) and their neighbours if both new faces point outwards.

    Return all faces and the faces that stay inverted.
    """
    all_faces, mended = faces.copy(), np.zeros(len(folded), np.bool_)
    # Only faces that have a corner in common with an inverted face can change.
    touched = np.zeros(len(places), np.bool_)
    touched[folded] = True
    about = touched[faces].any(axis=1)
    faces = faces[about]
    for number, corners in enumerate(folded):
        still = np.flatnonzero((faces == corners).all(axis=1))
        # An inverted face is absent if it was changed as the neighbour of another inverted face.
        mended[number] = not len(still)
        if mended[number]:
            continue
        mine = int(still[0])
        for turn in range(3):
            one, two, mine_far = np.roll(corners, -turn)
            both = np.flatnonzero((faces == one).any(axis=1) & (faces == two).any(axis=1))
            if len(both) < 2:
                continue  # The edge is at the border of the selected faces.
            across = int(both[both != mine][0])
            its_far = next(corner for corner in faces[across] if corner not in (one, two))
            pair = np.array([[one, its_far, mine_far], [its_far, two, mine_far]])
            joined = ((faces == its_far).any(axis=1) & (faces == mine_far).any(axis=1)).any()
            if not joined and not _is_facing_inwards(places[pair], field).any():
                faces[[mine, across]], mended[number] = pair, True
                break
    all_faces[about] = faces
    return all_faces, folded[~mended]


def _relax_around_fold(
    places: Array, around: NDArray[np.bool_], neighbour_mean_matrix: csr_array, field: ScalarField
) -> Array:
    """Distribute the selected vertices evenly over the field surface, and return their positions, in mm."""
    laid = places.copy()
    for _ in range(_FLATTENINGS):
        laid[around] = project_to_surface(neighbour_mean_matrix @ laid, field, None, 1)
    return project_to_surface(laid[around], field, None, 5)


def _is_facing_inwards(triangles: Array, field: ScalarField) -> NDArray[np.bool_]:
    """Test whether the vertex order of triangles (n, 3, 3) points inwards, against the field gradient."""
    one, two, three = (triangles[:, k] for k in range(3))
    _, outward = evaluate_with_gradient(field, (one + two + three) / 3)
    return np.asarray((np.cross(two - one, three - one) * outward).sum(axis=1) <= 0)


def refine_to_tolerance(solid: Manifold, field: ScalarField, tolerance_mm: float, rounds: int) -> Manifold:
    """Split the edges of a solid whose midpoints are farther from a field surface than a tolerance allows.

    Parameters
    ----------
    solid : Manifold
        Solid whose vertices are on the surface of the field.
    field : callable
        Distance field. It maps points (n, 3), in mm, to signed distances (n,), in mm.
    tolerance_mm : float
        Maximum distance of an edge midpoint from the surface, in mm.
    rounds : int
        Maximum number of times that edges are split.

    Returns
    -------
    Manifold
        Refined solid.

    Raises
    ------
    InputError
        If the refined mesh is not a valid solid.
    """
    mesh = extract_mesh(solid)
    places, faces = np.array(mesh.vertices), np.asarray(mesh.faces)
    places, faces = _split_edges_off_surface(places, faces, field, tolerance_mm, rounds)
    places, faces = _fix_inverted_faces(places, faces, np.ones(len(places), np.bool_), field)
    return build_solid(places, faces, "refined bone")


def _split_edges_off_surface(
    places: Array,
    faces: Indices,
    field: ScalarField,
    tolerance_mm: float,
    rounds: int,
    select_vertices: VertexSelector | None = None,
) -> tuple[Array, Indices]:
    """Split edges whose midpoints are too far from the field surface, and return vertices and faces.

    `select_vertices` maps vertices (n, 3) to booleans (n,). Only edges with both ends selected are split; None selects
    all vertices.
    """

    def off(places: Array, edges: Indices) -> tuple[Indices, Array]:
        middles = places[edges].mean(axis=1)
        settled = project_to_surface(middles, field, None, 3)
        away = np.linalg.norm(settled - middles, axis=1) > tolerance_mm
        return edges[away], settled[away]

    return split_selected_edges(places, faces, rounds, off, select_vertices)
