"""Check mesh repair: some faults are repaired with a warning, others raise an error."""

import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pssf.core.checks import InputError
from pssf.geometry.mesh_repair import repair_mesh, require_usable_solid
from pssf.geometry.mesh_topology import body_volumes_mm3, find_distinct_rows, hash_edge_balance

BOX = trimesh.creation.box(extents=(10, 20, 30))
POINTS, FACES = np.array(BOX.vertices), np.array(BOX.faces)


def compute_volume(points, faces):
    return float(body_volumes_mm3(points, faces, np.zeros(len(points), np.int32), 1)[0])


def require_repaired(points, faces, *lines, volume_mm3=6000.0):
    solid = repair_mesh(points, faces, "thing")
    assert [str(fault) for fault in solid.faults] == list(lines)
    assert hash_edge_balance(solid.faces) == 0
    assert compute_volume(solid.points, solid.faces) == pytest.approx(volume_mm3)
    require_usable_solid(solid)
    return solid


def require_rejected(points, faces, match):
    with pytest.raises(InputError, match=match):
        require_usable_solid(repair_mesh(np.asarray(points, float), np.asarray(faces), "thing"))


def test_a_closed_mesh_is_not_changed():
    assert np.array_equal(require_repaired(POINTS, FACES).faces, FACES)


def test_unmerged_triangles_are_merged_at_equal_vertices():
    soup = POINTS[FACES].reshape(-1, 3)
    # Vertices with coordinates 0.0 and -0.0 are equal.
    soup[soup == 0] *= -1
    require_repaired(soup, np.arange(36).reshape(-1, 3), "thing: duplicate vertices: 28, first 4, 5, 6, ...; merged")


def test_degenerate_and_duplicate_faces_are_removed():
    faces = np.vstack((FACES, [[0, 0, 1]], FACES[4:5, [1, 2, 0]]))
    require_repaired(
        POINTS, faces,
        "thing: faces with a repeated vertex: 1, first 12; removed",
        "thing: duplicate faces: 1, first 13; duplicates removed",
    )  # fmt: skip


def test_unused_vertices_are_ignored_even_if_not_finite():
    assert len(require_repaired(np.vstack((POINTS, [[np.nan, 0, 0]])), FACES).points) == 8


def test_an_inverted_mesh_is_flipped():
    require_repaired(POINTS, FACES[:, ::-1], "thing: mesh is inside out; faces: 12; flipped outward")


@pytest.mark.parametrize("turn", [1, -1])
def test_cavities_are_preserved_in_correct_and_inverted_meshes(turn):
    points = np.vstack((POINTS, 0.5 * POINTS))
    faces = np.vstack((FACES, FACES[:, ::-1] + 8))[:, ::turn]
    lines = [] if turn == 1 else ["thing: mesh is inside out; faces: 24; flipped outward"]
    require_repaired(points, faces, *lines, volume_mm3=6000 * (1 - 1 / 8))


def test_one_inverted_body_of_several_is_flipped():
    points = np.vstack((POINTS, 0.5 * POINTS + [40, 0, 0]))
    faces = np.vstack((FACES, FACES[:, ::-1] + 8))
    line = "thing: a body that is not a cavity is inside out; faces: 12; flipped outward"
    require_repaired(points, faces, line, volume_mm3=6000 * (1 + 1 / 8))


def test_two_boxes_with_a_common_face_in_one_mesh_are_closed():
    twice = np.vstack((POINTS, POINTS + np.array((10, 0, 0))))
    require_repaired(twice, np.vstack((FACES, FACES + 8)), volume_mm3=12000)


def unmerge_vertices(points, faces):
    """Give each triangle its own vertices."""
    return np.asarray(points)[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def concatenate_meshes(*meshes):
    """Concatenate meshes to one mesh."""
    return _concatenate([(np.array(mesh.vertices), np.array(mesh.faces)) for mesh in meshes])


def _concatenate(parts):
    before = np.cumsum([0] + [len(points) for points, _ in parts])
    faces = [faces + first for (_, faces), first in zip(parts, before[:-1], strict=True)]
    return np.vstack([points for points, _ in parts]), np.vstack(faces)


DUPLICATIONS = {
    "indexed": lambda points, faces, times: (points, np.vstack(times * [faces])),
    "side by side": lambda points, faces, times: _concatenate(times * [(points, faces)]),
    "unmerged": lambda points, faces, times: unmerge_vertices(points, np.vstack(times * [faces])),
}
BODIES = {
    "a ball": trimesh.creation.icosphere(2, 15.0),
    "a ring": trimesh.creation.annulus(10, 20, 8, sections=24),
    "two boxes apart": trimesh.util.concatenate([BOX, trimesh.creation.box(bounds=[[20, 0, 0], [30, 9, 7]])]),
}


@given(
    body=st.sampled_from(sorted(BODIES)),
    duplication=st.sampled_from(sorted(DUPLICATIONS)),
    times=st.integers(2, 4),
    more=st.integers(0, 10),
    seed=st.integers(0, 9),
)
def test_every_kind_of_duplicated_mesh_is_counted_once(body, duplication, times, more, seed):
    points, faces = np.array(BODIES[body].vertices), np.array(BODIES[body].faces)
    again, repeated = DUPLICATIONS[duplication](points, faces, times)
    repeated = np.vstack((repeated, repeated[:more]))
    solid = repair_mesh(again, np.random.default_rng(seed).permutation(repeated), "thing")
    assert len(solid.faces) == len(faces)
    assert compute_volume(solid.points, solid.faces) == pytest.approx(compute_volume(points, faces))
    twice = [fault for fault in solid.faults if fault.problem == "duplicate faces"]
    assert [fault.count for fault in twice] == [(times - 1) * len(faces) + more]
    require_usable_solid(solid)


def test_two_flush_bodies_of_equal_winding_each_keep_their_common_wall():
    # The inner body is flush with the outer one: the common wall has identical faces, and each body needs a copy.
    outer, inner = (trimesh.creation.box(bounds=[[0, 0, 0], [9, 9, depth]]) for depth in (9, 4))
    require_repaired(*concatenate_meshes(outer, inner), volume_mm3=9 * 9 * 13)


@given(body=st.sampled_from(sorted(BODIES)), seed=st.integers(0, 10**6))
def test_unmerged_triangles_give_the_same_solid_as_the_indexed_mesh(body, seed):
    points, faces = np.array(BODIES[body].vertices), np.array(BODIES[body].faces)
    faces = np.random.default_rng(seed).permutation(faces)
    indexed, welded = repair_mesh(points, faces, "thing"), repair_mesh(*unmerge_vertices(points, faces), "thing")
    assert (indexed.points[indexed.faces] == welded.points[welded.faces]).all()


def test_degenerate_faces_are_removed_from_a_closed_mesh_without_merging():
    twice = np.vstack((POINTS, POINTS + np.array((10, 0, 0))))
    faces = np.vstack((FACES, FACES + 8, [[3, 3, 3], [1, 1, 2]]))
    line = "thing: faces with a repeated vertex: 2, first 24, 25; removed"
    assert len(require_repaired(twice, faces, line, volume_mm3=12000).points) == 16


def test_unused_vertices_are_dropped_before_vertices_are_merged():
    points, faces = unmerge_vertices(POINTS, FACES)
    points = np.vstack((np.full((50_000, 3), np.nan), points))
    solid = require_repaired(
        points, faces + 50_000, "thing: duplicate vertices: 28, first 50004, 50005, 50006, ...; merged"
    )
    assert set(solid.source_vertices) <= set(range(50_000, 50_036))


def test_identical_rows_of_nan_count_as_one_distinct_row():
    first, number = find_distinct_rows(np.full((20_000, 3), np.nan))
    assert (len(first), number.max()) == (1, 0)


@pytest.mark.parametrize("size_mm", [1e-150, 1e60, 1e110, 1e200, 8e307])
def test_meshes_of_extreme_size_are_read_without_a_warning(size_mm):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not repair_mesh(POINTS / 15 * size_mm, FACES, "thing").faults


def test_a_mesh_whose_bodies_cancel_has_no_volume():
    require_rejected(
        *concatenate_meshes(BOX, trimesh.Trimesh(POINTS, FACES[:, ::-1], process=False)), "mesh has no volume"
    )


def test_an_empty_mesh_is_rejected():
    require_rejected(np.zeros((0, 3)), np.zeros((0, 3), int), "thing: mesh has 0 faces")


def test_the_error_for_a_hole_states_the_number_of_open_edges():
    require_rejected(
        POINTS, FACES[1:], r"thing: edges of a hole .*: 3, first \d-\d, \d-\d, \d-\d; the mesh must be closed"
    )


def test_an_open_sheet_is_rejected():
    require_rejected([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]], "open sheet, with one face only: 3")


def test_the_error_for_mixed_winding_states_the_number_of_edges():
    faces = FACES.copy()
    faces[0] = faces[0, ::-1]
    require_rejected(POINTS, faces, "edges between two faces of opposite winding: 3, first")


def test_a_fin_on_a_closed_mesh_is_rejected():
    require_rejected(np.vstack((POINTS, [[50, 0, 0]])), np.vstack((FACES, [[0, 1, 8]])), "do not close: 1, first 0-1")


def test_edges_in_errors_have_the_vertex_numbers_of_the_input_mesh():
    soup = POINTS[FACES[1:]].reshape(-1, 3)
    solid = repair_mesh(soup, np.arange(33).reshape(-1, 3), "thing")
    named = {tuple(p) for pair in solid.fatal_faults[0].first_items for p in soup[list(map(int, pair.split("-")))]}
    assert named <= {tuple(p) for p in POINTS[FACES[0]]}


def test_a_two_sided_sheet_without_volume_is_rejected():
    require_rejected([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]], "mesh has no volume")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_the_error_for_vertices_that_are_not_finite_names_the_first_ones(value):
    points = POINTS.copy()
    points[[3, 5], 1] = value
    require_rejected(points, FACES, "thing: vertices that are not finite: 2, first 3, 5; coordinates must be finite")


@pytest.mark.parametrize("vertex", [-1, 8])
def test_faces_with_missing_vertices_are_rejected(vertex):
    faces = FACES.copy()
    faces[7, 2] = vertex
    require_rejected(POINTS, faces, "faces with missing vertices: 1, first 7; indices must be 0 to 7")
