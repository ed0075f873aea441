"""Whether closed meshes lie within each other or apart."""

import numpy as np
import pytest
from manifold3d import Manifold

from pssf.anatomy.meshing.solids import extract_mesh
from pssf.geometry.mesh import Mesh
from pssf.geometry.mesh_containment import are_meshes_disjoint, is_mesh_within

BALL = Manifold.sphere(10.0, 48)


def test_a_ball_within_a_larger_one_is_within_and_not_the_other_way_round():
    small = extract_mesh(Manifold.sphere(9.5, 40).rotate((20.0, 30.0, 40.0)))
    assert is_mesh_within(small, extract_mesh(BALL))
    assert not is_mesh_within(extract_mesh(BALL), small)


@pytest.mark.parametrize("way", np.vstack((np.eye(3), -np.eye(3))).tolist(), ids=str)
def test_whether_a_solid_is_within_is_what_a_boolean_finds_left_of_it(way):
    inner = Manifold.sphere(7.0, 40) - Manifold.cube((4.0, 4.0, 20.0), True)
    for far_mm in np.linspace(0.05, 4.05, 21):
        moved = inner.translate(tuple(far_mm * np.array(way)))
        assert is_mesh_within(extract_mesh(moved), extract_mesh(BALL)) == ((moved - BALL).volume() == 0)


def test_a_spike_thinner_than_the_faces_it_goes_through_is_seen():
    needle = Manifold.cylinder(10.0, 1e-4, 1e-4, 3).translate((0.31, 0.17, 0.0))
    body = Manifold.sphere(3.0, 24)
    assert (body + needle - BALL).volume() > 0  # its end is just without
    assert not is_mesh_within(extract_mesh(body + needle), extract_mesh(BALL))
    assert is_mesh_within(extract_mesh(body + needle.translate((0.0, 0.0, -0.2))), extract_mesh(BALL))


def test_a_body_beside_those_that_are_within_and_one_in_a_cavity_are_not_within():
    box = Manifold.cube((60.0, 60.0, 60.0), True)
    outer = Manifold.compose([BALL, BALL.translate((25.0, 0.0, 0.0))])
    one, other = Manifold.sphere(2.0, 16), Manifold.sphere(2.0, 16).translate((25.0, 0.0, 0.0))
    assert is_mesh_within(extract_mesh(Manifold.compose([one, other])), extract_mesh(outer))
    between = Manifold.compose([one, Manifold.sphere(1.0, 16).translate((12.5, 0.0, 0.0))])
    assert not is_mesh_within(extract_mesh(between), extract_mesh(outer))
    assert not is_mesh_within(extract_mesh(one), extract_mesh(box - BALL))
    # Around the cavity there is none of the host.
    assert not is_mesh_within(extract_mesh(Manifold.sphere(20.0, 32)), extract_mesh(box - BALL))


def test_meshes_that_share_a_wall_are_not_within():
    cube = extract_mesh(Manifold.cube((10.0, 10.0, 10.0), True))
    assert not is_mesh_within(cube, cube)
    slab = extract_mesh(Manifold.cube((5.0, 5.0, 10.0), True))
    assert not is_mesh_within(slab, cube)
    # A face of no area tells nothing apart, and harms nothing.
    flat = Mesh(cube.vertices * 0.9, np.vstack((cube.faces, [[0, 0, 1], [0, 1, 0]])))
    assert is_mesh_within(flat, cube)


@pytest.mark.parametrize("way", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, -0.8)], ids=str)
def test_whether_solids_lie_apart_is_what_a_boolean_finds_shared(way):
    other = Manifold.sphere(4.0, 40).rotate((20.0, 30.0, 40.0))
    for far_mm in (0.0, 3.0, *np.linspace(13.7, 14.3, 13), 18.0, 60.0):
        moved = other.translate(tuple(far_mm * np.array(way)))
        apart = (moved ^ BALL).volume() == 0
        assert are_meshes_disjoint(extract_mesh(moved), extract_mesh(BALL)) == apart
        assert are_meshes_disjoint(extract_mesh(BALL), extract_mesh(moved)) == apart


def test_a_body_in_a_cavity_lies_apart_and_meshes_that_share_a_wall_do_not():
    shell = extract_mesh(Manifold.cube((60.0, 60.0, 60.0), True) - BALL)
    assert are_meshes_disjoint(extract_mesh(Manifold.sphere(2.0, 16)), shell)
    cube = extract_mesh(Manifold.cube((10.0, 10.0, 10.0), True))
    assert not are_meshes_disjoint(
        cube, extract_mesh(Manifold.cube((10.0, 10.0, 10.0), True).translate((10.0, 0.0, 0.0)))
    )
