"""Check the HTML viewer of a knee and its radiograph."""

import base64
import dataclasses
import importlib.util
import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import pssf
from pssf.io.meshes.knee_viewer import split_creases, write_viewer
from pssf.io.meshes.mesh_export import material_colour

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1200,500",
    "--virtual-time-budget=2000",
    "--enable-logging=stderr",
    "--dump-dom",
]


@pytest.fixture(scope="module")
def radiograph(built, small):
    return pssf.simulate(built, small, rng=7)


@pytest.fixture(scope="module")
def page(scene, radiograph, tmp_path_factory):
    return write_viewer(scene, radiograph, tmp_path_factory.mktemp("page") / "knee.html", title="A & B")


def parse_content(page):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page.read_text())[1])


def decode_mesh(layer):
    def decode_array(name, kind):
        return np.frombuffer(base64.b64decode(layer[name]), kind).reshape(-1, 3)

    points = decode_array("points", "<u2") * np.array(layer["step"]) + layer["low"]
    return trimesh.Trimesh(points, decode_array("faces", "<u4" if layer["wide"] else "<u2"), process=False)


def make_spheres():
    outer, inner = (trimesh.creation.icosphere(subdivisions=4, radius=radius) for radius in (40, 20))
    return pssf.Scene(
        [pssf.Surface(outer, "skin", "air", name="outer"), pssf.Surface(inner, "marrow", "skin", name="inner")]
    )


def is_thin_layer(name):
    return name.endswith(("_cartilage", "_meniscus", "fat_pad"))


def test_the_viewer_page_contains_every_surface_at_its_position(scene, page):
    layers = parse_content(page)["layers"]
    assert len(layers) == len(scene.surfaces)
    left = {surface.name: surface.solid for surface in scene.surfaces}
    for layer in layers:
        mesh = decode_mesh(layer)
        # The page does not store names, so the bounding box identifies the solid.
        name = min(left, key=lambda name: abs(left[name].points.min(axis=0) - mesh.bounds[0]).max())
        solid = left.pop(name)
        whole = trimesh.Trimesh(solid.points, solid.faces, process=False)
        # Simplification shortens margins that are thinner than the tolerance, as in cartilage and the fat pad.
        assert abs(mesh.bounds - whole.bounds).max() < (0.5 if is_thin_layer(name) else 0.06)
        assert abs(mesh.volume - whole.volume) < 0.06 * whole.area


def test_the_viewer_page_makes_no_network_requests(page):
    text = page.read_text()
    assert "default-src 'none'" in text
    assert set(re.findall(r"https?://[^\"'\s]+", text)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"<link|@import|\bfetch\(|XMLHttpRequest|\bimport\(|\ssrc=", text)


def test_the_viewer_page_of_a_knee_is_smaller_than_6_mb(page):
    assert page.stat().st_size < 6e6


def test_the_same_knee_gives_an_identical_viewer_page(scene, radiograph, page, tmp_path):
    again = write_viewer(scene, radiograph, tmp_path / "again.html", title="A & B")
    assert again.read_bytes() == page.read_bytes()


def test_the_radiograph_on_the_viewer_page_is_rendered_for_display(radiograph, page):
    displayed = parse_content(page)["radiograph"]
    with Image.open(io.BytesIO(base64.b64decode(displayed["png"].split(",")[1]))) as image:
        assert (np.asarray(image) == pssf.render_for_display(radiograph.pixels)).all()
    assert (displayed["height"], displayed["width"]) == radiograph.pixels.shape


def test_a_large_radiograph_is_scaled_down_with_its_landmarks(radiograph, tmp_path):
    large = dataclasses.replace(radiograph, pixels=np.kron(radiograph.pixels, np.ones((9, 9), np.uint16)))
    displayed = parse_content(write_viewer(make_spheres(), large, tmp_path / "large.html"))["radiograph"]
    assert (displayed["height"], displayed["width"]) == (768, 768)
    row, col = radiograph.truth.landmarks_px["joint_centre"]
    assert displayed["landmarks"]["joint centre"] == pytest.approx([(row + 0.5) / 2304, (col + 0.5) / 2304])


def test_bone_materials_are_listed_under_their_bone(page):
    layers = parse_content(page)["layers"]
    femur = {layer["label"]: layer["colour"] for layer in layers if layer["group"] == "femur"}
    assert {"cortical bone", "trabecular bone", "marrow"} <= set(femur)
    assert tuple(femur["marrow"]) == material_colour("marrow")
    assert {"skin", "adipose", "muscle"} <= {layer["label"] for layer in layers if layer["group"] == ""}


def test_numbered_surfaces_are_grouped_under_their_parent_surface(radiograph, tmp_path):
    box = trimesh.creation.box(extents=(5, 5, 5))
    names = ("leg", "leg_pin_1", "leg_pin_2", "pin", "pin")
    boxes = [box.copy().apply_translation((8 * k, 0, 0)) for k in range(5)]
    scene = pssf.Scene([pssf.Surface(m, "water", "air", name=n) for m, n in zip(boxes, names, strict=True)])
    layers = parse_content(write_viewer(scene, radiograph, tmp_path / "pins.html"))["layers"]
    rows = [(layer["group"], layer["label"]) for layer in layers]
    assert rows == [("leg", "leg"), ("leg", "pin"), ("leg", "pin"), ("", "pin"), ("", "pin")]


def test_names_and_titles_are_escaped_on_the_viewer_page(radiograph, tmp_path):
    evil = "</script><script>alert(1)</script>"
    box = trimesh.creation.box(extents=(9, 9, 9))
    path = write_viewer(pssf.Scene([pssf.Surface(box, evil, "air")]), radiograph, tmp_path / "x.html", title="<b>A</b>")
    assert evil not in path.read_text()
    assert "<b>A" not in path.read_text()
    assert parse_content(path)["layers"][0]["material"] == evil


def test_crease_splitting_keeps_boxes_sharp_and_spheres_smooth():
    points, normals, faces = split_creases(trimesh.creation.box())
    assert len(points) == 24
    assert sorted(map(tuple, np.abs(normals))) == sorted(map(tuple, np.repeat(np.eye(3), 8, axis=0)))
    assert trimesh.Trimesh(points, faces, process=False).volume == pytest.approx(1)
    ball = trimesh.creation.icosphere(subdivisions=3)
    points, normals, _ = split_creases(ball)
    assert len(points) == len(ball.vertices)
    assert (points * normals).sum(axis=1).min() > 0.98


def test_an_open_mesh_raises_an_error_and_no_viewer_page_is_written(radiograph, tmp_path):
    box = trimesh.creation.box(extents=(9, 9, 9))
    box.update_faces(np.arange(11))
    with pytest.raises(pssf.InputError, match="surface: edges of a hole"):
        write_viewer(pssf.Scene([pssf.Surface(box, "water", "air")]), radiograph, tmp_path / "x.html")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
def test_solids_are_rendered_hidden_and_cut_in_a_browser(radiograph, tmp_path):
    page = write_viewer(make_spheres(), radiograph, tmp_path / "spheres.html")
    script = """
      const renderPixels = () => {
        [...draw(12, true)];
        const canvas = find("canvas"), gl = canvas.getContext("webgl2");
        const pixels = new Uint8Array(4 * canvas.width * canvas.height);
        gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
        const middle = 4 * ((canvas.height >> 1) * canvas.width + (canvas.width >> 1));
        return [pixels.filter((value, k) => k % 4 === 3 && value > 0).length, ...pixels.slice(middle, middle + 4)];
      };
      const turned = (selector) => { find(selector).click(); return viewOf(300, 200).matrix; };
      const found = {}, [outer, inner] = document.querySelectorAll("label.row input");
      found.side = turned('[data-turn="90 0"]'); found.front = turned('[data-turn="0 0"]');
      found.both = renderPixels();
      outer.click(); found.inner = renderPixels();
      outer.click(); find("#opacity").value = 5; found.opaque = renderPixels();
      find("#cut").value = 0.5; found.cut = renderPixels();
      found.errors = find("canvas").getContext("webgl2").getError();
      document.title = JSON.stringify(found);
    </script></body>"""
    page.write_text(re.sub(r"</script>\s*</body>", lambda _: script, page.read_text()))
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert "CONSOLE" not in done.stderr
    found = json.loads(re.search("<title>(.*?)</title>", done.stdout)[1])
    assert found["errors"] == 0
    # Columns: directions of x, y and z on the screen (right, up, away from the viewer). Front is the image view.
    front, side = (np.reshape(found[name], (4, 4))[:3, [0, 1, 3]] for name in ("front", "side"))
    assert (np.sign(front.round(9)) == [[1, 0, 0], [0, 0, 1], [0, 1, 0]]).all()
    assert (np.sign(side.round(9)) == [[0, 0, -1], [1, 0, 0], [0, 1, 0]]).all()
    assert front[0, 0] * 300 == pytest.approx(front[2, 1] * 200)
    # Twice the radius gives four times the area; perspective adds a little.
    assert found["both"][0] / found["inner"][0] == pytest.approx(4.0, rel=0.05)
    # The central ray passes through four surfaces, each with the initial opacity of the slider.
    left = [(1 - material_colour(material)[3] / 255) ** (2 * 2**-0.7) for material in ("skin", "marrow")]
    assert found["both"][4] == pytest.approx(255 * (1 - left[0] * left[1]), abs=3)
    red, _, blue, opacity = found["opaque"][1:]
    assert opacity > 250
    # The colour is that of skin; the marrow behind the skin would have a ratio of 0.39.
    assert abs(blue / red - 140 / 224) < 0.08
    expected = [0.1 * 255 + 0.9 * value for value in material_colour("marrow")[:3]]
    assert found["cut"][1:] == pytest.approx([*expected, 255], abs=3)


def test_the_solids_example_shows_the_materials_inside_a_cut_bone(scene):
    path = Path(__file__).parents[1] / "examples" / "solids.py"
    spec = importlib.util.spec_from_file_location("solids", path)
    solids = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(solids)
    window = solids.Window(scene, solids.FRONT, rows=240)
    whole, cut = solids.render_in_limb(scene, window), solids.render_cut(scene, window, 3.0)

    def measure_fraction(image, material):
        return (np.abs(image.astype(int) - material_colour(material)[:3]).max(axis=2) <= 3).mean()

    for material, least in (("cortical_bone", 0.005), ("trabecular_bone", 0.05), ("marrow", 0.02)):
        assert measure_fraction(cut, material) > least
        assert measure_fraction(whole, material) < 0.002
