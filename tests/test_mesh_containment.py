"""Check containment and disjointness of closed meshes."""

import numpy as np
import pytest
from manifold3d import Manifold

from pssf.anatomy.meshing.solids import extract_mesh
from pssf.geometry.mesh import Mesh
from pssf.geometry.mesh_containment import are_meshes_disjoint, is_mesh_within

BALL = Manifold.sphere(10.0, 48)


def test_a_sphere_is_within_a_larger_one_but_not_vice_versa():
    small = extract_mesh(Manifold.sphere(9.5, 40).rotate((20.0, 30.0, 40.0)))
    assert is_mesh_within(small, extract_mesh(BALL))
    assert not is_mesh_within(extract_mesh(BALL), small)


@pytest.mark.parametrize("direction", np.vstack((np.eye(3), -np.eye(3))).tolist(), ids=str)
def test_containment_agrees_with_a_boolean_difference(direction):
    inner = Manifold.sphere(7.0, 40) - Manifold.cube((4.0, 4.0, 20.0), True)
    for far_mm in np.linspace(0.05, 4.05, 21):
        moved = inner.translate(tuple(far_mm * np.array(direction)))
        assert is_mesh_within(extract_mesh(moved), extract_mesh(BALL)) == ((moved - BALL).volume() == 0)


def test_a_thin_spike_that_protrudes_through_a_face_is_detected():
    needle = Manifold.cylinder(10.0, 1e-4, 1e-4, 3).translate((0.31, 0.17, 0.0))
    body = Manifold.sphere(3.0, 24)
    # The tip of the spike is just outside the ball.
    assert (body + needle - BALL).volume() > 0
    assert not is_mesh_within(extract_mesh(body + needle), extract_mesh(BALL))
    assert is_mesh_within(extract_mesh(body + needle.translate((0.0, 0.0, -0.2))), extract_mesh(BALL))


def test_bodies_outside_a_mesh_or_in_its_cavity_are_not_within_it():
    box = Manifold.cube((60.0, 60.0, 60.0), True)
    outer = Manifold.compose([BALL, BALL.translate((25.0, 0.0, 0.0))])
    one, other = Manifold.sphere(2.0, 16), Manifold.sphere(2.0, 16).translate((25.0, 0.0, 0.0))
    assert is_mesh_within(extract_mesh(Manifold.compose([one, other])), extract_mesh(outer))
    between = Manifold.compose([one, Manifold.sphere(1.0, 16).translate((12.5, 0.0, 0.0))])
    assert not is_mesh_within(extract_mesh(between), extract_mesh(outer))
    assert not is_mesh_within(extract_mesh(one), extract_mesh(box - BALL))
    # The larger sphere encloses the cavity and intersects the surrounding mesh.
    assert not is_mesh_within(extract_mesh(Manifold.sphere(20.0, 32)), extract_mesh(box - BALL))


def test_meshes_with_a_common_wall_are_not_within_each_other():
    cube = extract_mesh(Manifold.cube((10.0, 10.0, 10.0), True))
    assert not is_mesh_within(cube, cube)
    slab = extract_mesh(Manifold.cube((5.0, 5.0, 10.0), True))
    assert not is_mesh_within(slab, cube)
    # A face of zero area does not affect containment.
    flat = Mesh(cube.vertices * 0.9, np.vstack((cube.faces, [[0, 0, 1], [0, 1, 0]])))
    assert is_mesh_within(flat, cube)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, -0.8)], ids=str)
def test_disjointness_agrees_with_a_boolean_intersection(direction):
    other = Manifold.sphere(4.0, 40).rotate((20.0, 30.0, 40.0))
    for far_mm in (0.0, 3.0, *np.linspace(13.7, 14.3, 13), 18.0, 60.0):
        moved = other.translate(tuple(far_mm * np.array(direction)))
        disjoint = (moved ^ BALL).volume() == 0
        assert are_meshes_disjoint(extract_mesh(moved), extract_mesh(BALL)) == disjoint
        assert are_meshes_disjoint(extract_mesh(BALL), extract_mesh(moved)) == disjoint


def test_bodies_in_cavities_are_disjoint_and_touching_meshes_are_not():
    shell = extract_mesh(Manifold.cube((60.0, 60.0, 60.0), True) - BALL)
    assert are_meshes_disjoint(extract_mesh(Manifold.sphere(2.0, 16)), shell)
    cube = extract_mesh(Manifold.cube((10.0, 10.0, 10.0), True))
    assert not are_meshes_disjoint(
        cube, extract_mesh(Manifold.cube((10.0, 10.0, 10.0), True).translate((10.0, 0.0, 0.0)))
    )
