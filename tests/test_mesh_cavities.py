"""Check that cavities are distinguished from inverted bodies for any order of faces."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pssf.geometry.mesh_repair import repair_mesh
from pssf.geometry.mesh_topology import body_volumes_mm3

ONE = "thing: a body that is not a cavity is inside out; faces: 12; flipped outward"


def make_box(side_mm, *at_mm):
    mesh = trimesh.creation.box(3 * [side_mm])
    mesh.apply_translation(at_mm or (0, 0, 0))
    return mesh


def make_inverted(*meshes):
    mesh = trimesh.util.concatenate(meshes)
    mesh.invert()
    return mesh


# Scene name -> (bodies of the mesh, volume of the mesh in mm3, expected warnings).
SCENES = {
    "a hole flush with a side": ([make_box(40), make_inverted(make_box(10, 15, 0, 0))], 63000, []),
    "a hole flush with a corner": ([make_box(40), make_inverted(make_box(10, 15, 15, 15))], 63000, []),
    "a hole half outside the box": ([make_box(40), make_inverted(make_box(10, 20, 0, 0))], 63000, []),
    "a box beside it, inside out": ([make_box(40), make_inverted(make_box(10, 25, 0, 0))], 65000, [ONE]),
    "a box that is hardly within it, inside out": ([make_box(40), make_inverted(make_box(10, 24, 0, 0))], 65000, [ONE]),
    "a hole and an island in it": ([make_box(40), make_inverted(make_box(30)), make_box(10)], 38000, []),
    "a hole and an island in it, inside out": (
        [make_box(40), make_inverted(make_box(30)), make_inverted(make_box(10))], 38000, [ONE]
    ),
    "a hollow box apart, its outside inside out": (
        [make_box(40), make_inverted(make_box(10, 90, 0, 0)), make_inverted(make_box(5, 90, 0, 0))], 64875, [ONE]
    ),
    "a hollow box apart, wholly inside out": (
        [make_box(40), make_inverted(make_box(10, 90, 0, 0), make_inverted(make_box(5, 90, 0, 0)))],
        64875,
        ["thing: 2 bodies that are not cavities are inside out; faces: 24; flipped outward"],
    ),
    "as large a box beside it, inside out": ([make_box(40), make_inverted(make_box(40, 50, 0, 0))], 128000, [ONE]),
    "all of it inside out": (
        [make_inverted(make_box(40)), make_box(10)], 63000, ["thing: mesh is inside out; faces: 24; flipped outward"]
    ),
    "a hole thinner than any rounding shows": (
        [make_box(40), make_inverted(trimesh.creation.box(bounds=[[-20, -5, -5], [-20 + 1e-6, 5, 5]]))],
        64000 - 1e-4, []
    ),
}  # fmt: skip


@given(
    scene=st.sampled_from(sorted(SCENES)),
    seed=st.integers(0, 10**6),
    turn=st.floats(-180, 180),
    scale=st.sampled_from([1e-9, 1.0, 1e6]),
    offset_mm=st.sampled_from([0.0, 1e3]),
)
def test_cavities_do_not_depend_on_face_order_pose_or_scale(scene, seed, turn, scale, offset_mm):
    meshes, volume_mm3, lines = SCENES[scene]
    mesh, rng = trimesh.util.concatenate(meshes), np.random.default_rng(seed)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(turn), [1, 2, 3]))
    order = rng.permutation(len(mesh.vertices))
    faces = rng.permutation(np.argsort(order)[np.array(mesh.faces)])
    solid = repair_mesh(
        (np.array(mesh.vertices)[order] + offset_mm) * scale, np.roll(faces, rng.integers(3), axis=1), "thing"
    )
    assert [str(fault) for fault in solid.faults] == lines
    assert compute_volume(solid) / scale**3 == pytest.approx(volume_mm3, rel=1e-9)


def compute_volume(solid):
    return float(body_volumes_mm3(solid.points, solid.faces, np.zeros(len(solid.points), np.int32), 1)[0])


OCTAHEDRON = trimesh.convex.convex_hull(0.3 * np.vstack((np.eye(3), -np.eye(3))))


def make_porous_block(number, at_mm):
    """Make a 64 mm cube with octahedral cavities on a grid of 60 mm side length around a point."""
    side = int(np.ceil(number ** (1 / 3)))
    grid = (np.stack(np.unravel_index(np.arange(number), 3 * [side]), 1) - (side - 1) / 2) * (60 / side) + at_mm
    block = trimesh.creation.box(3 * [64])
    points = (grid[:, None] + OCTAHEDRON.vertices).reshape(-1, 3)
    faces = (OCTAHEDRON.faces[:, ::-1] + 6 * np.arange(number)[:, None, None]).reshape(-1, 3)
    return np.vstack((block.vertices, points)), np.vstack((block.faces, faces + 8))


def test_thousands_of_cavities_are_kept():
    solid = repair_mesh(*make_porous_block(8000, (0, 0, 0)), "thing")
    assert not solid.faults
    assert compute_volume(solid) == pytest.approx(64**3 - 8000 * OCTAHEDRON.volume)


def test_thousands_of_inverted_bodies_are_flipped_with_one_warning():
    solid = repair_mesh(*make_porous_block(8000, (100, 0, 0)), "thing")
    line = "thing: 8000 bodies that are not cavities are inside out; faces: 64000; flipped outward"
    assert [str(fault) for fault in solid.faults] == [line]
    assert compute_volume(solid) == pytest.approx(64**3 + 8000 * OCTAHEDRON.volume)
