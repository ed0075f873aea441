"""Check scenes and surfaces: bounds, size limits, validation and text."""

import dataclasses
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

import pssf
from pssf import (
    InputError,
    MeshNotice,
    PlaneWaves,
    Scene,
    Surface,
    check,
    trace,
)
from pssf.geometry.scene import require_traceable, resolve_scene
from pssf.geometry.view import View

VIEW = View(source_mm=(0.0, -900.0, 0.0), centre_mm=(0.0, 200.0, 0.0), rows=8, cols=8, pixel_mm=8.0)


def make_scene(mesh, **options):
    return Scene([Surface(mesh, inside="water", outside="air", name="thing")], **options)


@pytest.mark.parametrize("engine", ["embree", "scanline"])
@pytest.mark.parametrize("scatter", ["kernel", "none", "monte_carlo"])
def test_a_scene_without_surfaces_is_a_flat_field(engine, scatter, small):
    protocol = dataclasses.replace(
        small, rows=32, cols=32, pixel_mm=9.6, noise="none", scatter=scatter, scatter_photons=20_000
    )
    scene = Scene([])
    assert pssf.check(scene, protocol).ok
    radiograph = pssf.simulate(scene, protocol, engine=engine, keep=("primary", "path_mm"))
    assert radiograph.kept["path_mm"] == {}
    # Without a surface, only the inverse square law affects the signal.
    column = np.arange(32) - 15.5
    away_mm = np.hypot(*np.meshgrid(column, column)) * 9.6
    fall = (1 + (away_mm / protocol.sdd_mm) ** 2) ** -1.5
    primary = radiograph.kept["primary"]
    assert_allclose(primary / primary.max(), fall / fall.max(), rtol=2e-5)
    assert pssf.simulate(scene, protocol, engine="scanline").pixels.min() > 0


def test_materials_are_listed_once_with_the_ambient_first():
    box = trimesh.creation.box()
    scene = Scene([Surface(box, inside="water", outside="air"), Surface(box, inside="muscle", outside="water")])
    assert scene.materials == ("air", "water", "muscle")


def test_the_bounding_box_of_a_scene_ignores_unused_vertices():
    box = trimesh.creation.box(extents=(10, 20, 30))
    stray = trimesh.Trimesh(np.vstack((box.vertices, [[np.inf, 0, 0], [900, 0, 0]])), box.faces, process=False)
    assert np.array_equal(make_scene(stray).bounds_mm, [[-5, -10, -15], [5, 10, 15]])


@pytest.mark.parametrize(
    ("across_mm", "hint"),
    [
        (0.1, "if the mesh is in metres"),
        (4.9, "if the mesh is in centimetres"),
        (0.002, "the extent must be 5 to 3000 mm; or"),
        (1e5, r"if the mesh is in micrometres, use mesh.apply_scale\(0.001\)"),
        (1e-9, "the extent must be 5 to 3000 mm; or"),
    ],
)
def test_the_error_for_a_scene_in_other_units_contains_a_hint(across_mm, hint):
    scene = make_scene(trimesh.creation.box(extents=3 * [across_mm]))
    with pytest.raises(InputError, match=rf"scene is .* mm across; .*{hint}"):
        trace(scene, VIEW)


@pytest.mark.parametrize("across_mm", [0.1, 4000.0])
def test_an_explicitly_allowed_scene_size_is_traced(across_mm):
    scene = make_scene(trimesh.creation.box(extents=3 * [across_mm]), size_mm=(0.0, np.inf))
    assert trace(scene, VIEW, precision="float64").audit.unrepaired == 0


@pytest.mark.parametrize("across_mm", [1e60, 1e110, 1e200, 1e308])
@pytest.mark.parametrize("size_mm", [(5.0, 3000.0), (0.0, np.inf)])
def test_a_scene_of_extreme_size_raises_an_error_without_overflow(across_mm, size_mm):
    box = trimesh.creation.box()
    scene = make_scene(trimesh.Trimesh(box.vertices * across_mm, box.faces, process=False), size_mm=size_mm)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (line,) = str(check(scene)).splitlines()
    assert line.startswith(f"error: scene: scene is {across_mm:.4g} mm across; the extent must be ")
    with pytest.raises(InputError, match="mm across"):
        trace(scene, VIEW)


@pytest.mark.parametrize("across_mm", [2e-6, 1e-3, 1e6, 9e11])
def test_very_small_and_large_scenes_are_traced_if_allowed(across_mm):
    box = trimesh.creation.box()
    scene = make_scene(trimesh.Trimesh(box.vertices * across_mm, box.faces, process=False), size_mm=(0.0, np.inf))
    assert str(check(scene)) == "no faults"
    near, far, pixel_mm = -3.0 * across_mm, 2.0 * across_mm, across_mm / 8
    view = View(source_mm=(0.0, near, 0.0), centre_mm=(0.0, far, 0.0), rows=9, cols=9, pixel_mm=pixel_mm)
    assert trace(scene, view).path_mm["water"][4, 4] == pytest.approx(across_mm, rel=1e-6)


def test_a_scene_far_from_the_origin_raises_an_error():
    box = trimesh.creation.box(extents=3 * [1000.0])
    scene = make_scene(trimesh.Trimesh(box.vertices + 1e18, box.faces, process=False))
    assert (
        str(check(scene))
        == "error: scene: scene extends 1e+18 mm from the origin; the distance must be at most 1e+12 mm"
    )


@pytest.mark.parametrize("size_mm", [5.0, None, (5.0,), (5.0, 1.0), (-1.0, 5.0), (0.0, np.nan), ("5", "9"), "59"])
def test_an_invalid_scene_size_range_raises_an_error(size_mm):
    with pytest.raises(InputError, match="scene: size_mm"):
        make_scene(trimesh.creation.box(), size_mm=size_mm)


@pytest.mark.parametrize("surfaces", [None, 3, trimesh.creation.box(), [trimesh.creation.box()], "box"])
def test_a_scene_of_objects_that_are_not_surfaces_raises_an_error(surfaces):
    with pytest.raises(InputError, match=r"scene: .* must be a .*, got "):
        Scene(surfaces)


def test_only_scenes_and_objects_with_a_scene_are_accepted():
    scene = make_scene(trimesh.creation.box(extents=3 * [10]))
    assert resolve_scene(scene) is resolve_scene(SimpleNamespace(scene=scene)) is scene
    paths = trace(SimpleNamespace(scene=scene), VIEW)
    assert paths.scene is scene
    for thing in (None, "knee", [scene], scene.surfaces[0], SimpleNamespace(scene=3), trimesh.creation.box()):
        with pytest.raises(InputError, match=r"^scene must be a Scene or a built knee, got ") as error:
            trace(thing, VIEW)
        assert "\n" not in str(error.value)
        with pytest.raises(InputError, match=r"^scene must be a Scene or a built knee, got "):
            check(thing)


def test_scenes_and_surfaces_are_compared_and_printed_without_arrays():
    waves = PlaneWaves(amplitudes=(0.1,) * 500, waves_per_mm=((1.0, 2.0, 3.0),) * 500, phases=(0.0,) * 500)
    box = trimesh.creation.box(extents=3 * [10])
    surface = Surface(box, "water", "air", "thing", inside_density=waves)
    text = "Surface('thing', inside='water', outside='air', 12 faces, inside_density=PlaneWaves)"
    assert repr(surface) == text
    assert repr(Scene([surface])) == f"Scene(surfaces=({text},), ambient='air', size_mm=(5.0, 3000.0))"
    assert surface == surface
    assert surface != Surface(box, "water", "air", "thing", inside_density=waves)
    assert Scene([surface]) != Scene([surface])


def test_the_scene_table_changes_with_everything_that_affects_an_image():
    def make_table(size=10, inside="water", ambient="air", **more):
        return Scene(
            [Surface(trimesh.creation.box(extents=3 * [size]), inside, "air", "thing", **more)], ambient
        ).table()

    one = make_table()
    assert one == make_table()
    (surface,) = one["surfaces"]
    assert (surface["name"], surface["inside"], surface["vertices"], surface["faces"]) == ("thing", "water", 8, 12)
    waves = PlaneWaves(amplitudes=(0.1,), waves_per_mm=((1.0, 2.0, 3.0),), phases=(0.0,))
    others = [
        make_table(size=10.001),
        make_table(inside="muscle"),
        make_table(ambient="water"),
        make_table(inside_density=waves),
    ]
    assert all(other != one for other in others)


def test_a_repaired_mesh_gives_a_warning():
    box = trimesh.creation.box(extents=(10, 10, 10))
    with pytest.warns(MeshNotice, match="thing: mesh is inside out; faces: 12; flipped outward"):
        require_traceable(make_scene(trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False)))


def test_a_density_without_integrate_raises_an_error():
    with pytest.raises(InputError, match=r"thing: inside_density must be None or a Density .*, got 1\.5"):
        Surface(trimesh.creation.box(), inside="water", outside="air", name="thing", inside_density=1.5)
