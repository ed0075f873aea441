"""Check negative path lengths: small ones are accepted, large ones raise an error that names the cause."""

import numpy as np
import pytest
import trimesh
from test_difficult_scenes import make_prism
from test_raycast import ENGINES, make_ball, make_protocol

from pssf import (
    InputError,
    PlaneWaves,
    Scene,
    Surface,
    trace,
)
from pssf.geometry.view import resolve_view
from pssf.raycast import require_nonnegative_paths
from pssf.raycast.negative_paths import explain_negative_path, find_shortest_paths

VIEW = make_protocol(rows=96, cols=96, pixel_mm=0.3)


def make_folded_plate(depth_mm, side=1):
    """Make a plate of 20 x 20 mm with a given depth along the rays; its outline crosses itself at x = 10.5 mm.

    side  1, or -1 for the mirror image
    """
    outline = [(-10, -10), (10, -10), (10, -1), (11, 1), (11, -1), (10, 1), (10, 10), (-10, 10)]
    mesh = make_prism(np.array(outline, float), depth_mm)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    if side < 0:
        mesh = trimesh.Trimesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1], process=False)
    return mesh


def build_plate_scene(depth_mm):
    return Scene([Surface(make_folded_plate(depth_mm), "cortical_bone", "air", "plate")])


@pytest.mark.parametrize("engine", ENGINES)
def test_rays_through_a_small_fold_have_a_small_negative_path(engine):
    path_mm = trace(build_plate_scene(0.03), VIEW, engine=engine, precision="float64").path_mm["cortical_bone"]
    assert path_mm.min() == pytest.approx(-0.03, rel=1e-3)
    assert path_mm.max() == pytest.approx(0.03, rel=1e-3)
    assert 1 < (path_mm < -1e-6).sum() < 10


@pytest.mark.parametrize("engine", ENGINES)
def test_a_large_fold_raises_an_error_with_its_surface_and_pixel(engine):
    with pytest.raises(InputError) as error:
        trace(build_plate_scene(4.0), VIEW, engine=engine)
    text = str(error.value)
    assert text.startswith("cortical_bone: path length must be -0.05 mm or more, got -4 mm at pixel (4")
    assert text.endswith(": plate: mesh overlaps itself or is inside out along this ray")


def test_the_shortest_path_is_found_at_its_pixel():
    scene = build_plate_scene(0.03)
    path_mm = trace(scene, VIEW, engine="scanline", precision="float64").path_mm["cortical_bone"]
    least = find_shortest_paths(scene, resolve_view(VIEW))["cortical_bone"]
    assert path_mm[least.row, least.col] == path_mm.min() == pytest.approx(least.min_path_mm, rel=1e-12)
    assert least.negative_rays == (path_mm < -1e-4).sum()
    assert "air" not in find_shortest_paths(scene, resolve_view(VIEW))


def test_a_wrong_outside_material_is_named_as_the_cause():
    scene = Scene(
        [Surface(make_ball(30.0), "water", "air", "ball"), Surface(make_ball(10.0), "muscle", "marrow", "inner")]
    )
    why = explain_negative_path(scene, resolve_view(VIEW), "marrow", 48, 48)
    assert why.startswith("inner: outside is marrow, but rays find water (ball), over up to 20 mm of a ray")
    with pytest.raises(
        InputError,
        match=r"^marrow: path length must be .*, got -19.97 mm at pixel .*: inner: outside is marrow, but rays find",
    ):
        trace(scene, VIEW)


def test_requested_paths_in_the_ambient_material_are_also_checked():
    scene = Scene(
        [Surface(make_ball(30.0), "water", "air", "ball"), Surface(make_ball(10.0), "muscle", "air", "inner")]
    )
    assert trace(scene, VIEW).path_mm["water"].max() > 50
    with pytest.raises(
        InputError, match=r"^air: path length .*, got .*: inner: outside is air, but rays find water \(ball\)"
    ):
        trace(scene, VIEW, materials=["air"])


def test_a_negative_density_is_named_as_the_cause():
    shell = Surface(make_ball(30.0), "water", "air", inside_density=PlaneWaves(mean=-1.0))
    with pytest.raises(
        InputError,
        match=r"^water: path length must be -0.05 mm or more, got -.*: the integral of a density is negative",
    ):
        trace(Scene([shell]), VIEW)


def test_modified_path_lengths_are_checked_again():
    paths = trace(build_plate_scene(0.03), VIEW)
    require_nonnegative_paths(paths.path_mm, paths.scene, paths.view)
    paths.path_mm["cortical_bone"][3, 4] = -1.0
    with pytest.raises(
        InputError,
        match=r"^cortical_bone: path length must be .*, got -1 mm at pixel \(3, 4\): a surface has the wrong",
    ):
        require_nonnegative_paths(paths.path_mm, paths.scene, paths.view)
    paths.path_mm["cortical_bone"][3, 4] = np.nan
    with pytest.raises(InputError, match=r"^cortical_bone: path length must be .*, got nan mm at pixel \(3, 4\)"):
        require_nonnegative_paths(paths.path_mm, paths.scene, paths.view)
