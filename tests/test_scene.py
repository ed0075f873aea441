import numpy as np
import pytest
import trimesh

from pssf import InputError, Scene, Surface


def refused(mesh, match):
    with pytest.raises(InputError, match=match):
        Surface(mesh, inside="water", outside="air", name="thing")


def test_an_empty_mesh_is_refused():
    refused(trimesh.Trimesh(), "thing: mesh has 0 faces")


def test_an_open_mesh_is_refused_with_the_count_of_open_edges():
    box = trimesh.creation.box()
    refused(trimesh.Trimesh(box.vertices, box.faces[1:], process=False), "open or wound both ways at 3 edges")


def test_mixed_winding_is_refused():
    box = trimesh.creation.box()
    faces = box.faces.copy()
    faces[0] = faces[0, ::-1]
    refused(trimesh.Trimesh(box.vertices, faces, process=False), "wound both ways")


def test_a_mesh_with_nan_is_refused_with_the_first_vertex():
    box = trimesh.creation.box()
    vertices = np.array(box.vertices)
    vertices[3, 1] = np.nan
    refused(trimesh.Trimesh(vertices, box.faces, process=False), "1 vertices are not finite, first 3")


def test_a_mesh_that_is_inside_out_is_refused():
    box = trimesh.creation.box()
    refused(trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False), "inside out")


def test_a_scene_needs_a_surface():
    with pytest.raises(InputError, match="0 surfaces"):
        Scene([])


def test_materials_are_listed_once_ambient_first():
    box = trimesh.creation.box()
    scene = Scene([Surface(box, inside="water", outside="air"), Surface(box, inside="muscle", outside="water")])
    assert scene.materials == ("air", "water", "muscle")
