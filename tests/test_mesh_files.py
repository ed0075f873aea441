"""Check mesh files: every facet is read or an error names the fault, and exported scenes are read unchanged."""

import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import pssf

BOX = trimesh.creation.box(extents=(40, 40, 40))


def shift_mesh(mesh, x_mm):
    return mesh.copy().apply_translation([x_mm, 0, 0])


TWO = trimesh.util.concatenate([BOX, shift_mesh(BOX, 60)])


def format_ascii_stl(mesh, name, end):
    rows = [f"solid {name}"]
    for triangle, normal in zip(mesh.triangles, mesh.face_normals, strict=True):
        rows += ["facet normal {:g} {:g} {:g}".format(*normal), "outer loop"]
        rows += ["vertex {:g} {:g} {:g}".format(*corner) for corner in triangle] + ["endloop", "endfacet"]
    return "\n".join([*rows, end]) + "\n"


@pytest.fixture(scope="module")
def nested():
    """Build a scene of three boxes, two of them with the same name."""
    inner = pssf.Surface(trimesh.creation.box(extents=(10, 10, 10)), "Ti@4.51", "trabecular_bone", "screw")
    outer = pssf.Surface(BOX, "trabecular_bone", "muscle", "bone & marrow".replace(" & ", "-"))
    other = pssf.Surface(shift_mesh(trimesh.creation.box(extents=(7, 8, 9)), 55), "Ti@4.51", "muscle", "screw")
    return pssf.Scene([outer, inner, other], ambient="muscle")


@pytest.mark.parametrize("end", ["endsolid B", "end solid B", "ENDSOLID", "  endsolid facet vertex 1 2 3"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_every_body_of_an_ascii_stl_is_read(tmp_path, end, newline):
    text = format_ascii_stl(BOX, "A", "endsolid A") + format_ascii_stl(shift_mesh(BOX, 60), "B facet vertex 1 2 3", end)
    (tmp_path / "two.stl").write_bytes(text.replace("\n", newline).encode())
    mesh = pssf.read_mesh(tmp_path / "two.stl")
    assert len(mesh.faces) == 24
    assert mesh.volume == pytest.approx(128000)
    assert mesh.is_watertight


@pytest.mark.parametrize("prefix", [b"", b"\xef\xbb\xbf", b"\n\n"])
def test_an_stl_name_in_any_encoding_is_accepted(tmp_path, prefix):
    text = format_ascii_stl(BOX, "Sch\xe4del", "endsolid").encode("latin-1")
    (tmp_path / "latin.stl").write_bytes(prefix + text)
    assert len(pssf.read_mesh(tmp_path / "latin.stl").faces) == 12


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_a_comment_in_any_encoding_is_accepted(tmp_path, kind):
    content = TWO.export(file_type=kind)
    content = content if isinstance(content, bytes) else content.encode()
    first, rest = content.split(b"\n", 1)
    comment = b"# Sch\xe4del" if kind == "obj" else b"comment Sch\xe4del"
    lines = [comment, first, rest] if kind == "obj" else [first, rest.replace(b"element", comment + b"\nelement", 1)]
    (tmp_path / f"latin.{kind}").write_bytes(b"\n".join(lines))
    assert pssf.read_mesh(tmp_path / f"latin.{kind}").volume == pytest.approx(128000)


@given(fraction=st.floats(0.0, 0.999), kind=st.sampled_from(["stl", "text.stl", "ply", "text.ply", "glb"]))
def test_a_truncated_mesh_file_raises_an_error_with_its_name(tmp_path_factory, fraction, kind):
    options = {"encoding": "ascii"} if kind == "text.ply" else {}
    content = TWO.export(file_type="stl_ascii" if kind == "text.stl" else kind.split(".")[-1], **options)
    content = content if isinstance(content, bytes) else content.encode()
    path = tmp_path_factory.mktemp("cut") / f"cut.{kind}"
    path.write_bytes(content[: int(fraction * (len(content) - 12))])
    with pytest.raises(pssf.InputError, match=rf"cut\.{kind}") as raised:
        pssf.read_mesh(path)
    assert "No module" not in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("kind", "cut", "message"),
    [
        ("stl", lambda content: content[:-50], "the 24 facets that its header specifies, got 23.0"),
        ("stl", lambda content: content + b"more", "the 24 facets that its header specifies"),
        ("stl_ascii", lambda content: content[: content.rindex(b"endsolid")], "end with endsolid"),
        (
            "stl_ascii",
            lambda content: content.replace(b"endfacet", b"", 1),
            "got 24 facet and 23 endfacet keywords",
        ),
        ("stl_ascii", lambda content: content.replace(b"-20", b"-2O", 1), "vertex coordinates must be numbers"),
        ("glb", lambda content: content[:-1], "as its header specifies"),
    ],
)
def test_the_error_for_an_incomplete_mesh_file_names_the_missing_part(tmp_path, kind, cut, message):
    content = TWO.export(file_type=kind)
    path = tmp_path / f"cut.{kind.split('_')[0]}"
    path.write_bytes(cut(content if isinstance(content, bytes) else content.encode()))
    with pytest.raises(pssf.InputError, match=message):
        pssf.read_mesh(path)


def test_line_ends_after_a_binary_stl_are_accepted(tmp_path):
    (tmp_path / "more.stl").write_bytes(TWO.export(file_type="stl") + b"\r\n")
    assert len(pssf.read_mesh(tmp_path / "more.stl").faces) == 24


def test_an_obj_body_without_faces_gives_a_warning(tmp_path):
    text = TWO.export(file_type="obj")
    lines = text.split("\n")
    last = [number for number, line in enumerate(lines) if line.startswith("f ")][11]
    (tmp_path / "whole.obj").write_text(text)
    (tmp_path / "cut.obj").write_text("\n".join(lines[: last + 1]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(pssf.read_mesh(tmp_path / "whole.obj").faces) == 24
    with pytest.warns(pssf.MeshNotice, match=r"cut\.obj: vertices 9 to 16 are not used by any face"):
        pssf.read_mesh(tmp_path / "cut.obj")


@pytest.mark.parametrize("kind", ["glb", "3mf"])
def test_an_exported_scene_is_read_back_with_names_and_materials(nested, tmp_path, kind):
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
def test_an_exported_scene_has_the_same_path_lengths(nested, small, tmp_path, kind):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    one, two = (pssf.trace(scene, small, engine="scanline").path_mm for scene in (nested, pssf.read_scene(path)))
    for name, lengths in one.items():
        np.testing.assert_allclose(two[name], lengths, atol=2e-4)


def test_an_exported_scene_is_simulated_by_the_command_line(nested, tmp_path):
    from command_line import run

    limb = pssf.Surface(trimesh.creation.box(extents=(150, 150, 150)), "muscle", "air", "limb")
    nested = pssf.Scene([limb, *nested.surfaces])
    (path,) = pssf.export_meshes(nested, tmp_path, formats=("glb",), stem="boxes")
    small = ["--set", "rows=64", "--set", "cols=64", "--set", "pixel_mm=4.8", "--engine", "scanline"]
    done = run("simulate", "--scene", path, "--out", tmp_path / "out", "--formats", "json", *small)
    assert done.returncode == 0, done.stderr
    surfaces = pssf.load_parameters(done.stdout.strip())["scene"]["surfaces"]
    assert [surface["name"] for surface in surfaces] == [one.name for one in nested.surfaces]


@pytest.mark.parametrize("kind", ["glb", "3mf"])
def test_a_scene_file_cannot_be_read_as_one_mesh(nested, tmp_path, kind):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    with pytest.raises(pssf.InputError, match=r"scene: use pssf\.read_scene"):
        pssf.read_mesh(path)


def test_a_glb_file_without_materials_cannot_be_read_as_a_scene(tmp_path):
    (tmp_path / "other.glb").write_bytes(TWO.export(file_type="glb"))
    with pytest.raises(pssf.InputError, match="must specify the materials of all 1 meshes, got materials of 0"):
        pssf.read_scene(tmp_path / "other.glb")
    assert pssf.read_mesh(tmp_path / "other.glb").volume == pytest.approx(128000e9)


@pytest.mark.parametrize("kind", ["glb", "3mf"])
@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.99])
def test_a_truncated_scene_file_raises_an_error(nested, tmp_path, kind, fraction):
    (path,) = pssf.export_meshes(nested, tmp_path, formats=(kind,))
    path.write_bytes(path.read_bytes()[: int(fraction * path.stat().st_size)])
    with pytest.raises(pssf.InputError, match=rf"knee\.{kind} must"):
        pssf.read_scene(path)


def test_an_unsupported_mesh_format_raises_an_error_with_the_file_name(tmp_path):
    (tmp_path / "mesh.xyz3d").write_bytes(b"0 1 2")
    with pytest.raises(pssf.InputError, match=r"mesh\.xyz3d"):
        pssf.read_mesh(tmp_path / "mesh.xyz3d")
