"""Meshes as people have them: what is mended, and what is refused by name, count and place."""

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


def whole(points, faces):
    return float(body_volumes_mm3(points, faces, np.zeros(len(points), np.int32), 1)[0])


def mended(points, faces, *lines, volume_mm3=6000.0):
    solid = repair_mesh(points, faces, "thing")
    assert [str(fault) for fault in solid.faults] == list(lines)
    assert hash_edge_balance(solid.faces) == 0
    assert whole(solid.points, solid.faces) == pytest.approx(volume_mm3)
    require_usable_solid(solid)
    return solid


def refused(points, faces, match):
    with pytest.raises(InputError, match=match):
        require_usable_solid(repair_mesh(np.asarray(points, float), np.asarray(faces), "thing"))


def test_a_closed_mesh_is_taken_as_it_is():
    assert np.array_equal(mended(POINTS, FACES).faces, FACES)


def test_triangle_soup_is_welded_where_corners_are_equal():
    soup = POINTS[FACES].reshape(-1, 3)
    soup[soup == 0] *= -1  # -0.0 is the same place
    mended(soup, np.arange(36).reshape(-1, 3), "thing: duplicate vertices: 28, first 4, 5, 6, ...; merged")


def test_faces_with_two_equal_corners_and_repeated_faces_are_left_out():
    faces = np.vstack((FACES, [[0, 0, 1]], FACES[4:5, [1, 2, 0]]))
    mended(
        POINTS, faces,
        "thing: faces with a repeated vertex: 1, first 12; removed",
        "thing: duplicate faces: 1, first 13; duplicates removed",
    )  # fmt: skip


def test_vertices_without_a_face_do_not_matter_whatever_they_are():
    assert len(mended(np.vstack((POINTS, [[np.nan, 0, 0]])), FACES).points) == 8


def test_a_mesh_that_is_wholly_inside_out_is_turned():
    mended(POINTS, FACES[:, ::-1], "thing: mesh is inside out; faces: 12; flipped outward")


@pytest.mark.parametrize("turn", [1, -1])
def test_a_cavity_stays_a_cavity_when_the_mesh_is_right_and_when_it_is_inside_out(turn):
    points = np.vstack((POINTS, 0.5 * POINTS))
    faces = np.vstack((FACES, FACES[:, ::-1] + 8))[:, ::turn]
    lines = [] if turn == 1 else ["thing: mesh is inside out; faces: 24; flipped outward"]
    mended(points, faces, *lines, volume_mm3=6000 * (1 - 1 / 8))


def test_one_body_of_several_that_is_inside_out_is_turned():
    points = np.vstack((POINTS, 0.5 * POINTS + [40, 0, 0]))
    faces = np.vstack((FACES, FACES[:, ::-1] + 8))
    line = "thing: a body that is not a cavity is inside out; faces: 12; flipped outward"
    mended(points, faces, line, volume_mm3=6000 * (1 + 1 / 8))


def test_two_boxes_that_share_a_face_within_one_mesh_are_closed():
    twice = np.vstack((POINTS, POINTS + np.array((10, 0, 0))))
    mended(twice, np.vstack((FACES, FACES + 8)), volume_mm3=12000)


def soup(points, faces):
    """The same triangles, each with corners of its own."""
    return np.asarray(points)[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def side_by_side(*meshes):
    """Meshes as one, their vertices one after the other."""
    return _one([(np.array(mesh.vertices), np.array(mesh.faces)) for mesh in meshes])


def _one(parts):
    before = np.cumsum([0] + [len(points) for points, _ in parts])
    faces = [faces + first for (_, faces), first in zip(parts, before[:-1], strict=True)]
    return np.vstack([points for points, _ in parts]), np.vstack(faces)


WAYS = {
    "indexed": lambda points, faces, times: (points, np.vstack(times * [faces])),
    "side by side": lambda points, faces, times: _one(times * [(points, faces)]),
    "as soup": lambda points, faces, times: soup(points, np.vstack(times * [faces])),
}
BODIES = {
    "a ball": trimesh.creation.icosphere(2, 15.0),
    "a ring": trimesh.creation.annulus(10, 20, 8, sections=24),
    "two boxes apart": trimesh.util.concatenate([BOX, trimesh.creation.box(bounds=[[20, 0, 0], [30, 9, 7]])]),
}


@given(
    body=st.sampled_from(sorted(BODIES)),
    way=st.sampled_from(sorted(WAYS)),
    times=st.integers(2, 4),
    more=st.integers(0, 10),
    seed=st.integers(0, 9),
)
def test_a_mesh_that_is_given_more_than_once_counts_once_however_it_is_given(body, way, times, more, seed):
    points, faces = np.array(BODIES[body].vertices), np.array(BODIES[body].faces)
    again, repeated = WAYS[way](points, faces, times)
    repeated = np.vstack((repeated, repeated[:more]))
    solid = repair_mesh(again, np.random.default_rng(seed).permutation(repeated), "thing")
    assert len(solid.faces) == len(faces)
    assert whole(solid.points, solid.faces) == pytest.approx(whole(points, faces))
    twice = [fault for fault in solid.faults if fault.problem == "duplicate faces"]
    assert [fault.count for fault in twice] == [(times - 1) * len(faces) + more]
    require_usable_solid(solid)


def test_two_bodies_that_share_a_wall_wound_alike_keep_it_both():
    # One within the other, and flush with it: the two faces of that wall are the same, and each body needs its own.
    outer, inner = (trimesh.creation.box(bounds=[[0, 0, 0], [9, 9, depth]]) for depth in (9, 4))
    mended(*side_by_side(outer, inner), volume_mm3=9 * 9 * 13)


@given(body=st.sampled_from(sorted(BODIES)), seed=st.integers(0, 10**6))
def test_triangle_soup_bounds_what_the_indexed_mesh_bounds(body, seed):
    points, faces = np.array(BODIES[body].vertices), np.array(BODIES[body].faces)
    faces = np.random.default_rng(seed).permutation(faces)
    indexed, welded = repair_mesh(points, faces, "thing"), repair_mesh(*soup(points, faces), "thing")
    assert (indexed.points[indexed.faces] == welded.points[welded.faces]).all()


def test_faces_with_two_equal_corners_are_left_out_of_a_closed_mesh_too_and_nothing_is_welded():
    twice = np.vstack((POINTS, POINTS + np.array((10, 0, 0))))
    faces = np.vstack((FACES, FACES + 8, [[3, 3, 3], [1, 1, 2]]))
    line = "thing: faces with a repeated vertex: 2, first 24, 25; removed"
    assert len(mended(twice, faces, line, volume_mm3=12000).points) == 16


def test_unused_vertices_of_a_soup_are_dropped_before_equal_corners_are_sought():
    points, faces = soup(POINTS, FACES)
    points = np.vstack((np.full((50_000, 3), np.nan), points))
    solid = mended(points, faces + 50_000, "thing: duplicate vertices: 28, first 50004, 50005, 50006, ...; merged")
    assert set(solid.source_vertices) <= set(range(50_000, 50_036))


def test_rows_that_are_no_numbers_are_one_row():
    first, number = find_distinct_rows(np.full((20_000, 3), np.nan))
    assert (len(first), number.max()) == (1, 0)


@pytest.mark.parametrize("size_mm", [1e-150, 1e60, 1e110, 1e200, 8e307])
def test_no_size_is_too_large_or_too_small_to_be_read(size_mm):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not repair_mesh(POINTS / 15 * size_mm, FACES, "thing").faults


def test_a_mesh_that_takes_away_as_much_as_it_bounds_has_no_volume():
    refused(*side_by_side(BOX, trimesh.Trimesh(POINTS, FACES[:, ::-1], process=False)), "mesh has no volume")


def test_an_empty_mesh_is_refused():
    refused(np.zeros((0, 3)), np.zeros((0, 3), int), "thing: mesh has 0 faces")


def test_a_hole_is_refused_with_the_count_of_edges_and_the_first_of_them():
    refused(POINTS, FACES[1:], r"thing: edges of a hole .*: 3, first \d-\d, \d-\d, \d-\d; the mesh must be closed")


def test_an_open_sheet_is_refused():
    refused([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]], "open sheet, with one face only: 3")


def test_mixed_winding_is_refused_with_the_count_of_edges():
    faces = FACES.copy()
    faces[0] = faces[0, ::-1]
    refused(POINTS, faces, "edges between two faces of opposite winding: 3, first")


def test_a_fin_on_a_closed_mesh_is_refused():
    refused(np.vstack((POINTS, [[50, 0, 0]])), np.vstack((FACES, [[0, 1, 8]])), "do not close: 1, first 0-1")


def test_edges_of_a_refused_soup_are_named_by_the_vertices_that_the_user_has():
    soup = POINTS[FACES[1:]].reshape(-1, 3)
    solid = repair_mesh(soup, np.arange(33).reshape(-1, 3), "thing")
    place = {tuple(p) for pair in solid.fatal_faults[0].first_items for p in soup[list(map(int, pair.split("-")))]}
    assert place <= {tuple(p) for p in POINTS[FACES[0]]}


def test_a_sheet_of_two_sides_has_no_volume_and_is_refused():
    refused([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]], "mesh has no volume")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_vertices_that_are_not_finite_are_refused_with_the_first_of_them(value):
    points = POINTS.copy()
    points[[3, 5], 1] = value
    refused(points, FACES, "thing: vertices that are not finite: 2, first 3, 5; coordinates must be finite")


@pytest.mark.parametrize("vertex", [-1, 8])
def test_faces_with_vertices_that_are_not_there_are_refused(vertex):
    faces = FACES.copy()
    faces[7, 2] = vertex
    refused(POINTS, faces, "faces with missing vertices: 1, first 7; indices must be 0 to 7")
