"""Check saved radiographs and exported meshes."""

import errno
import json
import os
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
import tifffile
import trimesh
from conftest import forget_built_knees
from PIL import Image

import pssf
from pssf.io import atomic_write, cohort_records, radiograph_files
from pssf.io.meshes import mesh_export


@pytest.fixture(scope="module")
def radiograph(built, small):
    return pssf.simulate(built, small, rng=7)


def test_a_loaded_tiff_equals_the_saved_radiograph(radiograph, tmp_path):
    path = pssf.save(radiograph, tmp_path / "knee.tif")
    back = pssf.load(path)
    assert (back.pixels == radiograph.pixels).all()
    assert back.pixels.dtype == np.uint16
    for name in ("knee", "protocol", "seed", "truth", "engine", "audit", "versions"):
        assert getattr(back, name) == getattr(radiograph, name), name


def test_the_parameters_in_a_tiff_reproduce_its_pixels(radiograph, tmp_path):
    back = pssf.load(pssf.save(radiograph, tmp_path / "knee.tif"))
    forget_built_knees()
    assert (pssf.simulate(back.knee, back.protocol, rng=back.seed).pixels == radiograph.pixels).all()


def test_a_tiff_contains_its_pixel_size_and_versions(radiograph, tmp_path):
    with tifffile.TiffFile(pssf.save(radiograph, tmp_path / "knee.tif")) as tiff:
        tags = tiff.pages[0].tags
        assert tags["XResolution"].value[0] / tags["XResolution"].value[1] == pytest.approx(10 / 1.2)
        assert set(json.loads(tiff.pages[0].description)["versions"]) >= {"pssf", "embreex", "manifold3d", "spekpy"}


def test_tifffile_and_pillow_read_the_pixels_of_a_tiff(radiograph, tmp_path):
    path = pssf.save(radiograph, tmp_path / "knee.tif")
    assert (tifffile.imread(path) == radiograph.pixels).all()
    with Image.open(path) as image:
        assert (np.asarray(image) == radiograph.pixels).all()


def test_saving_the_same_radiograph_twice_gives_identical_files(radiograph, tmp_path):
    one, two = (pssf.save(radiograph, tmp_path / f"{k}.tif").read_bytes() for k in "ab")
    assert one == two


def test_an_exported_png_has_8_bits_and_the_size_of_the_radiograph(radiograph, tmp_path):
    with Image.open(pssf.save(radiograph, tmp_path / "knee.png")) as image:
        assert (image.mode, image.size) == ("L", (256, 256))


def test_an_unsupported_suffix_is_rejected(radiograph, tmp_path):
    with pytest.raises(pssf.InputError, match=r"suffix must be one of .tif, .*, got '.jpg'"):
        pssf.save(radiograph, tmp_path / "knee.jpg")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", ["cut", "foreign", "text", "missing"])
def test_a_damaged_tiff_is_named_in_the_error(radiograph, tmp_path, damage):
    path = tmp_path / "knee.tif"
    whole = pssf.save(radiograph, path).read_bytes()
    if damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "foreign":
        tifffile.imwrite(path, np.zeros((4, 4), np.uint16), description="other")
    elif damage == "text":
        path.write_text("hello")
    else:
        path.unlink()
    with pytest.raises(pssf.InputError, match=r"knee\.tif"):
        pssf.load(path)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES])
def test_a_full_or_unwritable_disk_leaves_no_partial_file(radiograph, tmp_path, monkeypatch, code):
    def fail(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(atomic_write.os, "fsync", fail)
    with pytest.raises(pssf.InputError, match=r"knee.tif must be writable, got .*: use a writable folder"):
        pssf.save(radiograph, tmp_path / "knee.tif")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_during_a_dicom_write_gives_a_one_line_error(radiograph, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError("[Errno 28] No space left on device\nWith tag (7FE0,0010) got exception:\nTraceback ...")

    monkeypatch.setattr("pssf.io.dicom.dicom_radiograph.Dataset.save_as", fail)
    with pytest.raises(pssf.InputError, match=r"knee.dcm must be writable, .*No space left on device\): ") as error:
        pssf.save(radiograph, tmp_path / "knee.dcm")
    assert "Traceback" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_only_temporary_files_of_terminated_writers_are_deleted(tmp_path):
    (tmp_path / ".pssf-dead-abcd1234.tif").write_bytes(b"half")
    for name in (".hidden", "knee.png"):
        (tmp_path / name).write_bytes(b"mine")
    with atomic_write.replace_file(tmp_path / "knee.tif") as temporary:
        temporary.write_bytes(b"whole")
        assert len(atomic_write.find_temporary_files(tmp_path)) == 2
        atomic_write.delete_stale_temporary_files(tmp_path)
        assert atomic_write.find_temporary_files(tmp_path) == [temporary]
    assert sorted(p.name for p in tmp_path.iterdir()) == [".hidden", "knee.png", "knee.tif"]


def test_a_writer_starts_again_if_its_unlocked_file_was_deleted(tmp_path, monkeypatch):
    lock, deleted = atomic_write.fcntl.flock, []

    def lock_late(handle, mode):
        if mode == atomic_write.fcntl.LOCK_EX and not deleted:
            deleted.append(handle)
            atomic_write.delete_stale_temporary_files(tmp_path)
        lock(handle, mode)

    monkeypatch.setattr(atomic_write.fcntl, "flock", lock_late)
    with atomic_write.replace_file(tmp_path / "knee.tif") as temporary:
        temporary.write_bytes(b"whole")
        atomic_write.delete_stale_temporary_files(tmp_path)  # would delete a file that is written without the lock
    assert len(deleted) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["knee.tif"]


def test_an_existing_file_survives_a_failed_write(radiograph, tmp_path, monkeypatch):
    path = tmp_path / "knee.tif"
    path.write_bytes(b"earlier")
    monkeypatch.setattr(radiograph_files.tifffile, "imwrite", lambda *a, **k: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        pssf.save(radiograph, path)
    assert [p.name for p in tmp_path.iterdir()] == ["knee.tif"]
    assert path.read_bytes() == b"earlier"


def test_exported_meshes_keep_their_volumes(scene, tmp_path):
    written = pssf.export_meshes(scene, tmp_path)
    assert len(written) == 2 * len(scene.surfaces) + 2
    for surface in scene.surfaces:
        for kind in ("stl", "ply"):
            mesh = pssf.read_mesh(tmp_path / f"knee-{surface.name}.{kind}")
            assert mesh.volume == pytest.approx(surface.mesh.volume, rel=1e-4)


def test_a_glb_has_a_named_node_with_material_per_surface(scene, tmp_path):
    pssf.export_meshes(scene, tmp_path, formats=("glb",))
    loaded = trimesh.load(tmp_path / "knee.glb")
    assert set(loaded.geometry) == {surface.name for surface in scene.surfaces}
    for surface in scene.surfaces:
        assert loaded.geometry[surface.name].visual.material.name == surface.inside
        assert loaded.geometry[surface.name].visual.material.alphaMode == "BLEND"
    # glTF uses metres; `read_scene` converts them to millimetres.
    low, high = scene.bounds_mm
    np.testing.assert_allclose(loaded.extents, (high - low) / 1000, rtol=1e-5)
    with pytest.warns(pssf.MeshNotice, match="does not contain the varying densities within .*femur_trabecular"):
        again = pssf.read_scene(tmp_path / "knee.glb")
    np.testing.assert_allclose(again.bounds_mm, scene.bounds_mm, atol=1e-4)


CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def read_3mf(path):
    """Return the root of a 3MF model, its objects by number, and (element, mesh) by name."""
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None
        assert package.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]
        assert {entry.date_time for entry in package.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        root = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    objects = {item.get("id"): item for item in root.iter(f"{CORE}object")}
    found = {}
    for item in objects.values():
        if item.find(f"{CORE}mesh") is not None:
            points = [[float(v.get(k)) for k in "xyz"] for v in item.iter(f"{CORE}vertex")]
            faces = [[int(t.get(k)) for k in ("v1", "v2", "v3")] for t in item.iter(f"{CORE}triangle")]
            found[item.get("name")] = (item, trimesh.Trimesh(points, faces, process=False))
    return root, objects, found


@pytest.fixture(scope="module")
def package(scene, tmp_path_factory):
    return pssf.export_meshes(scene, tmp_path_factory.mktemp("3mf"), formats=("3mf",))[0]


@pytest.fixture(scope="module")
def model(package):
    return read_3mf(package)


def test_a_3mf_has_a_named_object_in_millimetres_per_surface(scene, model):
    root, _, found = model
    assert root.get("unit") == "millimeter"
    assert list(found) == [surface.name for surface in scene.surfaces]
    for surface in scene.surfaces:
        item, mesh = found[surface.name]
        assert item.get("type") == "model"
        assert mesh.volume == pytest.approx(surface.mesh.volume, rel=1e-7)
        assert abs(mesh.vertices - surface.solid.points).max() < 1e-6


def test_a_3mf_has_a_named_and_coloured_material_per_surface(scene, model):
    root, _, found = model
    (group,) = root.iter(f"{CORE}basematerials")
    bases = [(base.get("name"), base.get("displaycolor")) for base in group]
    assert len(set(bases)) == len(bases) == len({surface.inside for surface in scene.surfaces})
    for surface in scene.surfaces:
        item = found[surface.name][0]
        assert item.get("pid") == group.get("id")
        name, colour = bases[int(item.get("pindex"))]
        assert name == surface.inside
        assert tuple(bytes.fromhex(colour[1:])) == mesh_export.material_colour(surface.inside)
        assert 0 < int(colour[7:], 16) < 255


def test_a_3mf_assembly_lists_inner_objects_after_outer_ones(model):
    root, objects, found = model
    (item,) = root.iter(f"{CORE}item")
    parts = [
        objects[part.get("objectid")].get("name") for part in objects[item.get("objectid")].iter(f"{CORE}component")
    ]
    assert sorted(parts) == sorted(found)
    for outer, inner in (("skin", "muscle"), ("muscle", "femur"), ("tibia", "tibia_trabecular")):
        assert parts.index(outer) < parts.index(inner)


def test_bodies_that_touch_at_an_edge_have_the_3mf_type_surface(tmp_path):
    cubes = [trimesh.creation.box(extents=(10, 10, 10)).apply_translation((k, k, 0)) for k in (0, 10)]
    mesh = trimesh.util.concatenate(cubes)
    mesh.merge_vertices()
    pssf.export_meshes(pssf.Scene([pssf.Surface(mesh, "water", "air")]), tmp_path, formats=("3mf",))
    _, _, found = read_3mf(tmp_path / "knee.3mf")
    assert [item.get("type") for item, _ in found.values()] == ["surface"]


def test_lib3mf_reads_a_3mf_without_a_warning(scene, package):
    lib3mf = pytest.importorskip("lib3mf", reason="uv run --with lib3mf pytest")
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(package))
    assert reader.GetWarningCount() == 0
    found, names = model.GetMeshObjects(), []
    while found.MoveNext():
        mesh = found.GetCurrentMeshObject()
        assert mesh.IsManifoldAndOriented()
        names.append(mesh.GetName())
    assert names == [surface.name for surface in scene.surfaces]


@pytest.mark.parametrize("kind", mesh_export.FORMATS)
def test_the_same_scene_gives_the_same_mesh_files(scene, tmp_path, kind):
    few = pssf.Scene(scene.surfaces[:4])
    one, two = (pssf.export_meshes(few, tmp_path / k, formats=(kind,)) for k in "ab")
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]


def test_ply_and_stl_contain_a_comment_and_ply_contains_a_colour(scene, tmp_path):
    femur = next(surface for surface in scene.surfaces if surface.name == "femur")
    pssf.export_meshes(pssf.Scene([femur]), tmp_path, formats=("ply", "stl"))
    remark = f"femur: cortical_bone in {femur.outside}, mm".encode()
    assert (tmp_path / "knee-femur.stl").read_bytes()[:80].strip() == b"STL " + remark
    assert b"comment " + remark in (tmp_path / "knee-femur.ply").read_bytes()[:400]
    colours = trimesh.load(tmp_path / "knee-femur.ply", process=False).visual.vertex_colors
    assert (colours == mesh_export.material_colour("cortical_bone")).all()


def test_an_export_tolerance_reduces_triangles_within_the_tolerance(scene, tmp_path):
    femur = next(surface for surface in scene.surfaces if surface.name == "femur")
    pssf.export_meshes(pssf.Scene([femur]), tmp_path, formats=("stl",), tolerance_mm=0.1)
    mesh = pssf.read_mesh(tmp_path / "knee-femur.stl")
    assert len(mesh.faces) < 0.7 * len(femur.mesh.faces)
    assert abs(mesh.volume - femur.mesh.volume) < 0.1 * femur.mesh.area
    assert abs(mesh.bounds - femur.mesh.bounds).max() < 0.1


def test_an_exported_scene_gives_the_same_path_lengths(scene, small, tmp_path):
    pssf.export_meshes(scene, tmp_path, formats=("stl",))
    again = pssf.Scene([
        pssf.Surface(pssf.read_mesh(tmp_path / f"knee-{s.name}.stl"), inside=s.inside, outside=s.outside, name=s.name)
        for s in scene.surfaces
    ])  # fmt: skip
    one, two = (pssf.trace(s, small, engine="scanline").path_mm["cortical_bone"] for s in (scene, again))
    # STL files store vertices in float32, which shifts outlines by micrometres.
    assert abs(one - two).max() < 0.2
    assert abs(one - two).mean() < 1e-4


@pytest.mark.parametrize("content", [None, b"not a mesh"])
def test_a_file_that_is_not_a_mesh_is_rejected(tmp_path, content):
    path = tmp_path / "bone.stl"
    if content:
        path.write_bytes(content)
    with pytest.raises(pssf.InputError, match=r"bone\.stl"):
        pssf.read_mesh(path)


def test_an_unknown_mesh_format_is_rejected(scene, tmp_path):
    with pytest.raises(pssf.InputError, match="format must be one of stl, ply, glb, 3mf, got 'obj3'"):
        pssf.export_meshes(scene, tmp_path, formats=("obj3",))


def test_the_error_for_a_cohort_with_other_settings_names_the_difference(tmp_path):
    cohort_records.claim_folder(tmp_path / "cohort.json", {"seed": 1, "knees": [{"a": 1}, {"a": 2}]})
    cohort_records.claim_folder(tmp_path / "cohort.json", {"seed": 1, "knees": [{"a": 1}, {"a": 2}]})
    with pytest.raises(pssf.InputError, match=r"knees\[1\].a = 2, requested 3"):
        cohort_records.claim_folder(tmp_path / "cohort.json", {"seed": 1, "knees": [{"a": 1}, {"a": 3}]})


def test_an_invalid_mesh_is_not_exported(tmp_path):
    box = trimesh.creation.box()
    inner = pssf.Surface(trimesh.Trimesh(), "muscle", "water", "inner")
    scene = pssf.Scene([pssf.Surface(box, "water", "air"), inner])
    with pytest.raises(pssf.InputError, match="inner: mesh has 0 faces"):
        pssf.export_meshes(scene, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("stem", ["../../x", "a/b", "..", "", None, "a\0"])
def test_a_mesh_name_must_not_contain_a_folder(scene, tmp_path, stem):
    with pytest.raises(pssf.InputError, match=r"stem must be a file name without a folder, got "):
        mesh_export.export_meshes(scene, tmp_path / "a" / "b", stem=stem)
    assert not list(tmp_path.iterdir())


def test_file_names_up_to_255_bytes_are_written(radiograph, tmp_path):
    assert pssf.load(pssf.save(radiograph, tmp_path / ("x" * 251 + ".tif"))) == radiograph
    with pytest.raises(pssf.InputError, match="File name too long"):
        pssf.save(radiograph, tmp_path / ("x" * 252 + ".tif"))


@pytest.mark.parametrize("path", [None, b"x.tif", "a\0b.tif", 3])
def test_an_invalid_path_is_rejected(radiograph, path):
    with pytest.raises(pssf.InputError, match="must be text or a Path without null bytes"):
        pssf.save(radiograph, path)


def test_an_object_that_is_not_a_radiograph_is_not_saved(tmp_path):
    with pytest.raises(pssf.InputError, match="radiograph must be a Radiograph, as returned by simulate, got 3"):
        pssf.save(3, tmp_path / "x.tif")


@pytest.mark.skipif(os.name == "nt", reason="Windows has no file modes")
@pytest.mark.parametrize("umask", [0o077, 0o022, 0o002])
def test_a_new_file_has_the_permissions_of_the_umask(tmp_path, umask):
    before = os.umask(umask)
    try:
        atomic_write.write_bytes(tmp_path / "new.csv", b"a")
        (tmp_path / "plain.csv").write_bytes(b"a")
    finally:
        os.umask(before)
    assert (tmp_path / "new.csv").stat().st_mode == (tmp_path / "plain.csv").stat().st_mode


@pytest.mark.skipif(os.name == "nt", reason="Windows has no file modes")
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664, 0o444])
def test_a_replaced_file_has_the_same_permissions_as_before(tmp_path, mode):
    path = tmp_path / "table.csv"
    path.write_bytes(b"before")
    path.chmod(mode)
    with atomic_write.replace_file(path) as temporary:
        assert temporary.stat().st_mode & 0o777 == 0o600
        temporary.write_bytes(b"after")
    assert path.stat().st_mode & 0o777 == mode
    assert path.read_bytes() == b"after"


@pytest.mark.parametrize("code", [errno.EPERM, errno.EINVAL, errno.EOPNOTSUPP])
def test_files_are_written_without_support_for_chmod_and_fsync(tmp_path, monkeypatch, code):
    def fail(*_, **__):
        raise OSError(code, os.strerror(code))

    for name in ("chmod", "fchmod", "fsync"):
        monkeypatch.setattr(atomic_write.os, name, fail)
    for content in (b"new", b"written anew"):
        atomic_write.write_bytes(tmp_path / "table.csv", content)
        assert (tmp_path / "table.csv").read_bytes() == content
    assert len(list(tmp_path.iterdir())) == 1
