"""Check that cutting a closed mesh at a height gives the same solid as trimming by a plane."""

import numpy as np
import pytest
from manifold3d import Manifold
from numpy.testing import assert_allclose, assert_array_equal

from pssf.anatomy.meshing.solids import build_solid, extract_mesh
from pssf.geometry.mesh import Mesh
from pssf.geometry.mesh_cut import cut_mesh_at_height


def column() -> Manifold:
    return Manifold.cylinder(40.0, 9.0, 7.0, 41).refine_to_length(3.0).rotate((4.0, -7.0, 0.0))


@pytest.mark.parametrize("up", [1, -1])
@pytest.mark.parametrize("end_mm", [4.0, 17.3, 30.0])
def test_a_cut_mesh_equals_the_solid_trimmed_by_the_plane(up, end_mm):
    whole = column()
    cut = cut_mesh_at_height(extract_mesh(whole), up, end_mm)
    trimmed = whole.trim_by_plane((0.0, 0.0, -float(up)), -up * end_mm)
    solid = build_solid(*cut, "cut")
    assert_allclose(solid.volume(), trimmed.volume(), rtol=1e-12)
    assert_allclose(solid.surface_area(), trimmed.surface_area(), rtol=1e-12)
    assert (up * cut.vertices[:, 2]).max() == up * end_mm
    sides = np.vstack([cut.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    there, back = (set(map(tuple, ends.tolist())) for ends in (sides, sides[:, ::-1]))
    assert there == back
    assert len(there) == len(sides)
    assert_array_equal(np.unique(cut.faces), np.arange(len(cut.vertices)))


def test_cutting_keeps_vertices_at_the_cut_and_meshes_below_it():
    whole = extract_mesh(Manifold.cylinder(10.0, 5.0, 5.0, 24).refine_to_length(2.0))
    level = np.unique(whole.vertices[:, 2])[2]
    assert_allclose(
        build_solid(*cut_mesh_at_height(whole, 1, level), "cut").volume(),
        level * build_solid(*whole, "w").volume() / 10.0,
    )
    assert cut_mesh_at_height(whole, 1, 10.0) is whole
    assert isinstance(cut_mesh_at_height(whole, -1, 3.0), Mesh)
