"""Mesh files: every facet of them or a refusal that names the fault, and scenes that come back as they were."""

import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import pssf

BOX = trimesh.creation.box(extents=(40, 40, 40))


def beside(mesh, x_mm):
    return mesh.copy().apply_translation([x_mm, 0, 0])


TWO = trimesh.util.concatenate([BOX, beside(BOX, 60)])


def ascii_stl(mesh, name, end):
    rows = [f"solid {name}"]
    for triangle, normal in zip(mesh.triangles, mesh.face_normals, strict=True):
        rows += ["facet normal {:g} {:g} {:g}".format(*normal), "outer loop"]
        rows += ["vertex {:g} {:g} {:g}".format(*corner) for corner in triangle] + ["endloop", "endfacet"]
    return "\n".join([*rows, end]) + "\n"


@pytest.fixture(scope="module")
def nested():
    """A scene of three boxes, two of one name, in water."""
    inner = pssf.Surface(trimesh.creation.box(extents=(10, 10, 10)), "Ti@4.51", "trabecular_bone", "screw")
    outer = pssf.Surface(BOX, "trabecular_bone", "muscle", "bone & marrow".replace(" & ", "-"))
    other = pssf.Surface(beside(trimesh.creation.box(extents=(7, 8, 9)), 55), "Ti@4.51", "muscle", "screw")
    return pssf.Scene([outer, inner, other], ambient="muscle")


@pytest.mark.parametrize("end", ["endsolid B", "end solid B", "ENDSOLID", "  endsolid facet vertex 1 2 3"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_every_body_of_an_ascii_stl_is_read(tmp_path, end, newline):
    text = ascii_stl(BOX, "A", "endsolid A") + ascii_stl(beside(BOX, 60), "B facet vertex 1 2 3", end)
    (tmp_path / "two.stl").write_bytes(text.replace("\n", newline).encode())
    mesh = pssf.read_mesh(tmp_path / "two.stl")
    assert len(mesh.faces) == 24
    assert mesh.volume == pytest.approx(128000)
    assert mesh.is_watertight


@pytest.mark.parametrize("prefix", [b"", b"\xef\xbb\xbf", b"\n\n"])
def test_a_name_of_any_encoding_is_no_fault_of_an_stl(tmp_path, prefix):
    text = ascii_stl(BOX, "Sch\xe4del", "endsolid").encode("latin-1")
    (tmp_path / "latin.stl").write_bytes(prefix + text)
    assert len(pssf.read_mesh(tmp_path / "latin.stl").faces) == 12


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_a_remark_of_any_encoding_is_no_fault_of_another_file(tmp_path, kind):
    content = TWO.export(file_type=kind)
    content = content if isinstance(content, bytes) else content.encode()
    first, rest = content.split(b"\n", 1)
    remark = b"# Sch\xe4del" if kind == "obj" else b"comment Sch\xe4del"
    lines = [remark, first, rest] if kind == "obj" else [first, rest.replace(b"element", remark + b"\nelement", 1)]
    (tmp_path / f"latin.{kind}").write_bytes(b"\n".join(lines))
    assert pssf.read_mesh(tmp_path / f"latin.{kind}").volume == pytest.approx(128000)


@given(share=st.floats(0.0, 0.999), kind=st.sampled_from(["stl", "text.stl", "ply", "text.ply", "glb"]))
def test_a_mesh_file_that_is_cut_off_anywhere_is_refused_by_its_own_fault(tmp_path_factory, share, kind):
    options = {"encoding": "ascii"} if kind == "text.ply" else {}
    content = TWO.export(file_type="stl_ascii" if kind == "text.stl" else kind.split(".")[-1], **options)
    content = content if isinstance(content, bytes) else content.encode()
    path = tmp_path_factory.mktemp("cut") / f"cut.{kind}"
    path.write_bytes(content[: int(share * (len(content) - 12))])
    with pytest.raises(pssf.InputError, match=rf"cut\.{kind}") as refused:
        pssf.read_mesh(path)
    assert "No module" not in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "cut", "told"),
    [
        ("stl", lambda content: content[:-50], "the 24 facets that its header announces, got bytes for 23.0"),
        ("stl", lambda content: content + b"more", "the 24 facets that its header announces"),
        ("stl_ascii", lambda content: content[: content.rindex(b"endsolid")], "end with endsolid"),
        ("stl_ascii", lambda content: content.replace(b"endfacet", b"", 1), "got 24 begun, 23 ended, 72 corners"),
        ("stl_ascii", lambda content: content.replace(b"-20", b"-2O", 1), "corners must be numbers"),
        ("glb", lambda content: content[:-1], "as its header says"),
    ],
)
def test_a_refusal_says_what_a_mesh_file_lacks(tmp_path, kind, cut, told):
    content = TWO.export(file_type=kind)
    path = tmp_path / f"cut.{kind.split('_')[0]}"
    path.write_bytes(cut(content if isinstance(content, bytes) else content.encode()))
    with pytest.raises(pssf.InputError, match=told):
        pssf.read_mesh(path)


def test_line_ends_after_a_binary_stl_are_no_fault(tmp_path):
    (tmp_path / "more.stl").write_bytes(TWO.export(file_type="stl") + b"\r\n")
    assert len(pssf.read_mesh(tmp_path / "more.stl").faces) == 24


def test_an_obj_whose_last_body_has_lost_its_faces_gets_a_warning(tmp_path):
    text = TWO.export(file_type="obj")
    lines = text.split("\n")
    last = [number for number, line in enumerate(lines) if line.startswith("f ")][11]
    (tmp_path / "whole.obj").write_text(text)
    (tmp_path / "cut.obj").write_text("\n".join(lines[: last + 1]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(pssf.read_mesh(tmp_path / "whole.obj").faces) == 24
    with pytest.warns(pssf.MeshNotice, match=r"cut\.obj: its vertices 9 to 16 belong to no face"):
        pssf.read_mesh(tmp_path / "cut.obj")


@pytest.mark.parametrize("kind", ["glb", "3mf"])
def test_an_exported_scene_comes_back_with_names_and_materials(nested, tmp_path, kind):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    again = pssf.read_scene(path)
    assert again.ambient == "muscle"
    assert [(one.name, one.inside, one.outside) for one in again.surfaces] == [
        (one.name, one.inside, one.outside) for one in nested.surfaces
    ]
    for one, two in zip(nested.surfaces, again.surfaces, strict=True):
        np.testing.assert_array_equal(one.solid.points.astype(np.float32), two.mesh_arrays.vertices.astype(np.float32))
        np.testing.assert_array_equal(one.solid.faces, two.mesh_arrays.faces)


@pytest.mark.parametrize("kind", ["glb", "3mf"])
def test_an_exported_scene_traces_as_it_did(nested, small, tmp_path, kind):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    one, two = (pssf.trace(scene, small, engine="scanline").path_mm for scene in (nested, pssf.read_scene(path)))
    for name, lengths in one.items():
        np.testing.assert_allclose(two[name], lengths, atol=2e-4)


def test_an_exported_scene_is_read_at_the_command_line(nested, tmp_path):
    from command import run

    limb = pssf.Surface(trimesh.creation.box(extents=(150, 150, 150)), "muscle", "air", "limb")
    nested = pssf.Scene([limb, *nested.surfaces])
    (path,) = pssf.export_meshes(nested, tmp_path, formats=("glb",), stem="boxes")
    small = ["--set", "rows=64", "--set", "cols=64", "--set", "pixel_mm=4.8", "--engine", "scanline"]
    done = run("simulate", "--scene", path, "--out", tmp_path / "out", "--formats", "json", *small)
    assert done.returncode == 0, done.stderr
    surfaces = pssf.load_parameters(done.stdout.strip())["scene"]["surfaces"]
    assert [surface["name"] for surface in surfaces] == [one.name for one in nested.surfaces]


@pytest.mark.parametrize("kind", ["glb", "3mf"])
def test_a_scene_is_not_joined_to_one_mesh(nested, tmp_path, kind):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    with pytest.raises(pssf.InputError, match=r"a scene: use pssf\.read_scene"):
        pssf.read_mesh(path)


def test_a_glb_of_another_program_names_no_materials(tmp_path):
    (tmp_path / "other.glb").write_bytes(TWO.export(file_type="glb"))
    with pytest.raises(pssf.InputError, match="must name materials of its 1 meshes, got 0"):
        pssf.read_scene(tmp_path / "other.glb")
    assert pssf.read_mesh(tmp_path / "other.glb").volume == pytest.approx(128000e9)


@pytest.mark.parametrize("kind", ["glb", "3mf"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_an_exported_scene_that_is_cut_off_is_refused(nested, tmp_path, kind, share):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(pssf.InputError, match=rf"knee\.{kind} must"):
        pssf.read_scene(path)


def test_a_kind_of_file_that_is_not_read_is_named(tmp_path):
    (tmp_path / "mesh.xyz3d").write_bytes(b"0 1 2")
    with pytest.raises(pssf.InputError, match=r"mesh\.xyz3d"):
        pssf.read_mesh(tmp_path / "mesh.xyz3d")
