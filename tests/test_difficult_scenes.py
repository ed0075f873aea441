"""Check scenes that are difficult for ray casters: both engines give the exact path length or raise an error."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from test_raycast import (
    ENGINES,
    compute_box_length,
    compute_convex_chord,
    compute_rays,
    make_ball,
    make_box,
    make_protocol,
    make_scene,
    move_mesh,
)

from pssf import (
    InputError,
    PlaneWaves,
    Scene,
    Surface,
    simulate,
    trace,
)
from pssf.geometry.view import View, resolve_view

# Error bounds of the engines in mm. Path lengths are compared in float64, without rounding by storage.
SCANLINE_MM, EMBREE_MM = 1e-6, 1e-4
BOUND_MM = {"scanline": SCANLINE_MM, "embree": EMBREE_MM}
pytestmark = pytest.mark.parametrize("engine", ENGINES)


def trace_path(mesh, view, engine):
    """Trace the path length in a mesh (rows, cols) and check that no ray remains unrepaired."""
    paths = trace(
        make_scene(mesh) if isinstance(mesh, trimesh.Trimesh) else mesh, view, engine=engine, precision="float64"
    )
    assert paths.audit.unrepaired == 0
    return paths.path_mm["water"]


def make_view(rows=33, cols=33, pixel_mm=2.0, source=(0.0, -900.0, 0.0), centre=(0.0, 200.0, 0.0)):
    return View(source_mm=source, centre_mm=centre, rows=rows, cols=cols, pixel_mm=pixel_mm)


def make_unbounded_scene(*surfaces):
    return Scene(surfaces, size_mm=(0.0, np.inf))


def make_water_surface(mesh, name="thing"):
    return Surface(mesh, inside="water", outside="air", name=name)


def test_a_ray_through_a_vertex_crosses_the_solid_once(engine):
    mesh = trimesh.creation.icosahedron()
    mesh.apply_scale(30.0)
    aimed = mesh.vertices[np.argmin(mesh.vertices[:, 1])]
    view = make_view(rows=1, cols=1, centre=tuple(np.array([0, -900, 0]) + (aimed - [0, -900, 0]) * 1.3))
    assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=BOUND_MM[engine])


def test_paths_in_the_plane_of_a_face_are_between_zero_and_the_depth(engine):
    # The source is in the plane x = 0 of a face, so the central column of rays is in that plane.
    mesh = make_box(20, 20, 20, at=(10.0, 0.0, 0.0))
    chord = trace_path(mesh, make_view(cols=3, pixel_mm=1.0), engine)
    whole = np.linalg.norm(compute_rays(make_view(cols=3, pixel_mm=1.0))[1], axis=-1) / 1100 * 20
    assert (chord[:, 1] >= 0).all()
    assert (chord[:, 1] <= whole[:, 1] + 1e-9).all()
    assert_allclose(chord[:, 0], 0, atol=1e-12)


def test_vertices_and_edges_on_pixel_centres_are_counted_once(engine):
    # The front edges project onto pixel centres: 10 mm x 1100/880 = 12.5 mm = 5 pixels of 2.5 mm.
    mesh = make_box(20, 40, 20)
    view = make_view(rows=15, cols=15, pixel_mm=2.5)
    inner = np.s_[4:11, 4:11]
    assert_allclose(
        trace_path(mesh, view, engine)[inner], compute_convex_chord(mesh, view)[inner], rtol=0, atol=BOUND_MM[engine]
    )
    assert_allclose(trace_path(mesh, view, engine)[[0, -1]], 0, atol=1e-12)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (7.0, 3.0, -5.0)])
def test_from_a_source_inside_a_solid_only_the_path_ahead_is_counted(engine, at):
    mesh = make_ball(60.0, at=(0.0, -900.0, 0.0))
    view = make_view(source=tuple(np.array([0.0, -900.0, 0.0]) + at))
    assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=BOUND_MM[engine])
    # The 33 rays of the central column may be parallel to mesh edges and are then repaired.
    assert trace(make_scene(mesh), view, engine=engine).audit.repaired <= 33


@pytest.mark.parametrize("y_mm", [-930.0, -900.0, -870.0])
def test_only_mesh_parts_in_front_of_the_source_are_traced(engine, y_mm):
    mesh = make_box(30, 100, 30, at=(40.0, y_mm, 0.0), turn_deg=(10.0, 20.0, 30.0))
    view = make_view(rows=65, cols=65, pixel_mm=60.0)
    expected = compute_convex_chord(mesh, view)
    assert expected.max() > 10
    assert_allclose(trace_path(mesh, view, engine), expected, rtol=0, atol=BOUND_MM[engine])


def test_only_the_part_of_a_ring_in_front_of_the_source_is_traced(engine):
    mesh = move_mesh(trimesh.creation.annulus(r_min=50, r_max=60, height=80, sections=200), at=(0.0, -900.0, 0.0))
    view = make_view(pixel_mm=4.0)
    # The central row is in the plane of the ring; its walls are polygons, so the tolerance is their sagitta.
    assert_allclose(trace_path(mesh, view, engine)[16], 10.0, rtol=0, atol=60 * (1 - np.cos(np.pi / 200)))


def test_a_mesh_behind_the_source_has_path_length_zero(engine):
    assert not trace_path(make_ball(30.0, at=(0.0, -1000.0, 0.0)), make_view(), engine).any()


def test_the_path_of_a_source_on_a_face_that_all_rays_enter_is_exact(engine):
    mesh = make_box(40, 40, 40, at=(0.0, -880.0, 0.0))
    assert_allclose(
        trace_path(mesh, make_view(), engine), compute_convex_chord(mesh, make_view()), rtol=0, atol=BOUND_MM[engine]
    )


def test_a_source_on_a_surface_that_only_some_rays_enter_raises_an_error(engine):
    with pytest.raises(InputError, match="thing: source_mm must be inside or outside the surface, got"):
        trace_path(make_box(40, 40, 40, at=(20.0, -900.0, 0.0)), make_view(), engine)


@pytest.mark.parametrize("y_mm", [150.0, 200.0, 230.0, 300.0])
def test_only_mesh_parts_in_front_of_the_detector_are_traced(engine, y_mm):
    mesh = make_ball(40.0, at=(3.0, y_mm, 2.0))
    assert_allclose(
        trace_path(mesh, make_view(), engine), compute_convex_chord(mesh, make_view()), rtol=0, atol=BOUND_MM[engine]
    )


@pytest.mark.parametrize("joined", ["two surfaces", "one mesh"])
def test_two_boxes_with_a_common_face_equal_one_box(engine, joined):
    near, far = make_box(30, 20, 30, at=(0.0, -10.0, 0.0)), make_box(30, 20, 30, at=(0.0, 10.0, 0.0))
    if joined == "one mesh":
        scene = make_scene(trimesh.util.concatenate([near, far]))
    else:
        scene = Scene([make_water_surface(near, "near"), make_water_surface(far, "far")])
    assert_allclose(
        trace_path(scene, make_view(), engine),
        compute_convex_chord(make_box(30, 40, 30), make_view()),
        rtol=0,
        atol=BOUND_MM[engine],
    )


@pytest.mark.parametrize("joined", ["two surfaces", "one mesh"])
def test_a_shell_of_a_thousandth_of_a_millimetre_has_its_thickness(engine, joined):
    outer, inner = make_box(60, 60, 60), make_box(59.998, 59.998, 59.998)
    if joined == "one mesh":
        inner.invert()
        scene = make_scene(trimesh.util.concatenate([outer, inner]))
    else:
        scene = Scene([make_water_surface(outer), Surface(inner, "muscle", "water", "inner")])
    view = make_view(pixel_mm=1.9)
    expected = compute_convex_chord(outer, view) - compute_convex_chord(make_box(59.998, 59.998, 59.998), view)
    assert_allclose(trace_path(scene, view, engine), expected, rtol=0, atol=1e-9 if engine == "scanline" else 1e-5)


def test_triangles_of_aspect_ratio_one_million_do_not_leak(engine):
    # A cylinder 60 mm high; part of its wall consists of triangles 6e-5 mm wide.
    angle = np.unique(np.concatenate((np.linspace(0, 2 * np.pi, 60)[:-1], 1.0 + np.arange(40) * 2e-6)))
    ring = np.column_stack((30 * np.cos(angle), 30 * np.sin(angle)))
    mesh = move_mesh(make_prism(ring, 60.0), turn_deg=(25.0, 35.0, 15.0))
    view = make_view(rows=97, cols=97, pixel_mm=0.9)
    assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=BOUND_MM[engine])


def make_prism(ring, height_mm):
    """Make a right prism over a convex ring (n, 2), with narrow triangles on its sides and fans at its ends."""
    n = len(ring)
    points = np.vstack(
        (np.column_stack((ring, np.full(n, -height_mm / 2))), np.column_stack((ring, np.full(n, height_mm / 2))))
    )
    one, other = np.arange(n), (np.arange(n) + 1) % n
    fan = np.column_stack((np.zeros(n - 2, int), one[1:-1], one[2:]))
    sides = np.vstack((np.column_stack((one, other, other + n)), np.column_stack((one, other + n, one + n))))
    return trimesh.Trimesh(points, np.vstack((sides, fan[:, ::-1], fan + n)), process=False)


def test_duplicate_and_degenerate_faces_are_removed_with_a_warning(engine):
    mesh = make_box(30, 30, 30)
    faces = np.vstack((mesh.faces, mesh.faces[3:5], [[2, 2, 5]]))
    with pytest.warns(UserWarning, match="removed"):
        chord = trace_path(trimesh.Trimesh(mesh.vertices, faces, process=False), make_view(), engine)
    assert_allclose(chord, compute_convex_chord(mesh, make_view()), rtol=0, atol=BOUND_MM[engine])


def test_zero_area_faces_that_close_a_seam_change_nothing(engine):
    # A new vertex splits an edge of one face; a face of zero area joins it to the unsplit edge of the adjacent face.
    mesh = make_box(30, 30, 30)
    face = mesh.faces[0]
    middle = mesh.vertices[face[:2]].mean(axis=0)
    faces = np.vstack((mesh.faces[1:], [[face[0], 8, face[2]], [8, face[1], face[2]], [face[0], face[1], 8]]))
    seamed = trimesh.Trimesh(np.vstack((mesh.vertices, middle)), faces, process=False)
    assert_allclose(
        trace_path(seamed, make_view(), engine), compute_convex_chord(mesh, make_view()), rtol=0, atol=BOUND_MM[engine]
    )


@pytest.mark.parametrize("fault", ["hole", "winding", "nan", "infinite", "empty"])
def test_a_mesh_that_bounds_no_solid_raises_an_error_before_tracing(engine, fault):
    mesh = make_box(30, 30, 30)
    points, faces = np.array(mesh.vertices), np.array(mesh.faces)
    if fault == "hole":
        faces, line = faces[1:], "edges of a hole or an open sheet, with one face only: 3"
    elif fault == "winding":
        faces[2], line = faces[2, ::-1], "edges between two faces of opposite winding: 3"
    elif fault == "empty":
        faces, line = faces[:0], "mesh has 0 faces"
    else:
        points[2, 0], line = (np.nan if fault == "nan" else np.inf), "vertices that are not finite: 1, first 2"
    with pytest.raises(InputError, match=f"thing: {line}"):
        trace_path(trimesh.Trimesh(points, faces, process=False), make_view(), engine)


def test_an_inverted_mesh_is_flipped_with_a_warning(engine):
    mesh = make_ball(30.0)
    mesh.invert()
    with pytest.warns(UserWarning, match="thing: mesh is inside out; faces: 1280; flipped outward"):
        chord = trace_path(mesh, make_view(), engine)
    assert_allclose(chord, compute_convex_chord(make_ball(30.0), make_view()), rtol=0, atol=BOUND_MM[engine])


def test_path_in_a_self_overlap_is_counted_by_its_winding_number(engine):
    near, far = make_ball(20.0, at=(0.0, -10.0, 0.0)), make_ball(20.0, at=(0.0, 10.0, 3.0))
    both = trimesh.util.concatenate([near, far])
    expected = compute_convex_chord(near, make_view()) + compute_convex_chord(far, make_view())
    assert_allclose(trace_path(both, make_view(), engine), expected, rtol=0, atol=2 * BOUND_MM[engine])


@pytest.mark.parametrize(
    ("rings", "around", "error_mm"), [(577, 866, 5e-3), pytest.param(1291, 1937, 1e-3, marks=pytest.mark.slow)]
)
def test_millions_of_triangles_are_traced_to_micrometres(engine, rings, around, error_mm):
    mesh = make_globe(rings, around, 60.0)
    assert len(mesh.faces) == 2 * around * (rings - 1)
    view = make_view(rows=24, cols=24, pixel_mm=5.0)
    _, direction = compute_rays(view)
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    sphere = 2 * np.sqrt(np.maximum(60.0**2 - (900.0**2 - (unit[..., 1] * 900.0) ** 2), 0.0))
    # A chord of the polyhedron is shorter by the sagitta over the cosine; grazing rays are excluded.
    steep = sphere > 30.0
    assert_allclose(trace_path(mesh, view, engine)[steep], sphere[steep], rtol=0, atol=error_mm)


def make_globe(rings, around, radius_mm):
    """Make a sphere of about 2 x rings x around triangles, by latitude and longitude."""
    latitude = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    longitude = np.arange(around) * 2 * np.pi / around
    parts = (
        np.sin(latitude) * np.cos(longitude),
        np.sin(latitude) * np.sin(longitude),
        np.cos(latitude) + 0 * longitude,
    )
    points = np.vstack((np.stack(parts, -1).reshape(-1, 3), [[0, 0, 1], [0, 0, -1]])) * radius_mm
    one = np.arange(rings - 2)[:, None] * around + np.arange(around)
    other = np.arange(rings - 2)[:, None] * around + (np.arange(around) + 1) % around
    sides = [(one, one + around, other), (other, one + around, other + around)]
    first, second, last = one[0], other[0], (rings - 2) * around
    caps = [
        (np.full(around, len(points) - 2), first, second),
        (np.full(around, len(points) - 1), last + second, last + first),
    ]
    faces = np.vstack([np.stack(part, -1).reshape(-1, 3) for part in sides + caps])
    return trimesh.Trimesh(points, faces, process=False)


def test_a_scene_100_metres_from_the_origin_has_the_same_accuracy(engine):
    offset = np.array([1e5, -1e5, 1e5])
    mesh = make_ball(30.0, at=tuple(offset), turn_deg=(20.0, 30.0, 40.0))
    view = make_view(source=tuple(offset - (0, 900, 0)), centre=tuple(offset + np.array((0, 200, 0))))
    assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=BOUND_MM[engine])


@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, 4096), (4096, 1)])
def test_detectors_of_one_pixel_or_one_line_are_exact(engine, rows, cols):
    view = make_view(rows=rows, cols=cols, pixel_mm=0.02)
    mesh = make_ball(30.0)
    assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=BOUND_MM[engine])


def test_a_solid_between_pixel_centres_is_crossed_by_no_ray(engine):
    view = make_view(rows=2, cols=2, pixel_mm=20.0)
    assert not trace_path(make_unbounded_scene(make_water_surface(make_box(3, 3, 3))), view, engine).any()


@pytest.mark.parametrize("pixel_mm", [0.001, 50.0])
def test_pixels_of_a_micrometre_and_of_50_millimetres_are_exact(engine, pixel_mm):
    view = make_view(pixel_mm=pixel_mm)
    mesh = make_ball(30.0, turn_deg=(5.0, 6.0, 7.0))
    assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=BOUND_MM[engine])


def test_a_cone_beam_of_170_degrees_is_exact(engine):
    # Half the detector width is 1100 mm x tan 85 degrees.
    view = make_view(rows=65, cols=65, pixel_mm=2 * 1100 * np.tan(np.deg2rad(85)) / 64)
    mesh = make_box(500, 400, 500, at=(0.0, -640.0, 0.0))
    expected = compute_convex_chord(mesh, view)
    assert (expected > 0).mean() > 0.002
    assert_allclose(trace_path(mesh, view, engine), expected, rtol=0, atol=BOUND_MM[engine])
    wide = make_box(11000, 80, 11000)
    assert_allclose(
        trace_path(make_unbounded_scene(make_water_surface(wide)), view, engine),
        compute_convex_chord(wide, view),
        rtol=0,
        atol=BOUND_MM[engine] * 10,
    )


def test_large_faces_seen_edge_on_do_not_leak(engine):
    # The planes of the plates contain the source or miss it by up to 1e-5 mm; all other pixels are exact.
    for off_mm in (0.0, 1e-9, 1e-5):
        mesh = make_box(20, 200, 60, at=(10.0 + off_mm, 0.0, 0.0))
        view = make_view(rows=65, cols=65, pixel_mm=0.5)
        chord, expected = trace_path(mesh, view, engine), compute_convex_chord(mesh, view)
        beside = np.ones(65, bool)
        beside[32] = False
        assert_allclose(chord[:, beside], expected[:, beside], rtol=0, atol=BOUND_MM[engine])
        assert (chord[:, 32] >= -1e-9).all()
        assert (chord[:, 32] < 210).all()


@pytest.mark.parametrize("turn_deg", [0.006, 0.05, -0.006, -0.05])
def test_rays_closer_to_an_edge_than_float32_resolution_are_exact(engine, turn_deg):
    # Rays meet the face beyond an edge at 1e-4 to 1e-3 rad, so the path length changes by up to 0.3 mm within 4e-5 mm.
    mesh = make_box(40, 40, 40, turn_deg=(0.0, 0.0, np.rad2deg(np.arctan2(20, 900)) + turn_deg))
    for edge in mesh.vertices[mesh.vertices[:, 2] > 0]:
        across = edge[0] * 1100 / (edge[1] + 900)
        view = make_view(rows=4, cols=400, pixel_mm=2e-7, centre=(float(across), 200.0, 1.0))
        assert_allclose(trace_path(mesh, view, engine), compute_convex_chord(mesh, view), rtol=0, atol=1e-5)


def test_cavities_are_empty_and_paths_through_several_bodies_add_up(engine):
    outer, hollow, other = make_ball(30.0), make_ball(15.0, at=(3.0, 2.0, 1.0)), make_ball(10.0, at=(50.0, 0.0, 0.0))
    expected = (
        compute_convex_chord(outer, make_view())
        - compute_convex_chord(hollow, make_view())
        + compute_convex_chord(other, make_view())
    )
    hollow.invert()
    mesh = trimesh.util.concatenate([outer, hollow, other])
    assert_allclose(trace_path(mesh, make_view(), engine), expected, rtol=0, atol=3 * BOUND_MM[engine])


@pytest.mark.parametrize("first", [0, 9, 11])
def test_a_hole_that_touches_an_outer_wall_is_empty_for_any_face_order(engine, first):
    outer, hole = make_box(40, 40, 40), make_box(10, 10, 10, at=(15.0, 0.0, 0.0))
    faces = np.vstack((outer.faces, np.roll(hole.faces[:, ::-1], -first, axis=0) + 8))
    mesh = trimesh.Trimesh(np.vstack((outer.vertices, hole.vertices)), faces, process=False)
    expected = compute_convex_chord(outer, make_view()) - compute_convex_chord(hole, make_view())
    assert_allclose(trace_path(mesh, make_view(), engine), expected, rtol=0, atol=2 * BOUND_MM[engine])


@pytest.mark.parametrize("duplication", ["indexed", "side by side"])
def test_a_duplicated_mesh_is_counted_once_with_a_warning(engine, duplication):
    mesh = make_ball(30.0)
    if duplication == "indexed":
        twice = trimesh.Trimesh(mesh.vertices, np.vstack((mesh.faces, mesh.faces)), process=False)
    else:
        twice = trimesh.util.concatenate([mesh, mesh])
    with pytest.warns(
        UserWarning, match="thing: duplicate faces: 1280, first 1280, 1281, 1282, ...; duplicates removed"
    ):
        chord = trace_path(twice, make_view(), engine)
    assert_allclose(chord, compute_convex_chord(mesh, make_view()), rtol=0, atol=BOUND_MM[engine])


def test_unmerged_triangles_of_an_stl_are_merged_with_a_warning(engine):
    mesh = make_ball(30.0)
    soup = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * 1280).reshape(-1, 3), process=False)
    with pytest.warns(UserWarning, match="thing: duplicate vertices: 3198, .*; merged"):
        chord = trace_path(soup, make_view(), engine)
    assert_allclose(chord, compute_convex_chord(mesh, make_view()), rtol=0, atol=BOUND_MM[engine])


@pytest.mark.parametrize("source", [(0.0, -900.0, 0.0), (4.0, 2.0, 3.0)])
def test_a_density_field_is_integrated_between_the_crossings(engine, source):
    wave = PlaneWaves(
        mean=0.8, amplitudes=(0.3, 0.2), waves_per_mm=((0.4, 0.3, -0.2), (0.0, 2.0, 0.0)), phases=(0.5, 1.0)
    )
    shell, core = make_ball(30.0), make_ball(20.0, at=(3.0, 2.0, 1.0))
    view = make_view(source=source)
    scene = Scene([
        Surface(shell, "water", "air", "shell", inside_density=wave),
        Surface(core, "muscle", "water", "core", outside_density=wave),
    ])  # fmt: skip
    found = trace_path(scene, view, engine)
    assert_allclose(
        found,
        integrate_in_convex_mesh(shell, view, wave) - integrate_in_convex_mesh(core, view, wave),
        rtol=0,
        atol=5 * BOUND_MM[engine],
    )
    assert_allclose(trace(scene, view, engine=engine).path_mm["muscle"], compute_convex_chord(core, view), atol=1e-4)


def integrate_in_convex_mesh(mesh, view, density):
    """Integrate a density inside a convex mesh (rows, cols), from the entry and exit of rays at its half-spaces."""
    source, direction = compute_rays(view)
    normals = np.cross(*(mesh.triangles[:, corner] - mesh.triangles[:, 0] for corner in (1, 2)))
    heights, slopes = ((mesh.triangles[:, 0] - source) * normals).sum(axis=1), direction.reshape(-1, 3) @ normals.T
    with np.errstate(divide="ignore"):
        at = heights / slopes
    near = np.maximum(np.where(slopes < 0, at, 0.0).max(axis=1), 0.0)[:, None]
    far = np.maximum(np.minimum(np.where(slopes > 0, at, 1.0).min(axis=1), 1.0)[:, None], near)
    ends = (source + part * direction.reshape(-1, 3) for part in (near, far))
    return density.integrate(*ends).reshape(view.rows, view.cols)


def test_a_detector_inside_the_scene_gives_an_image(engine):
    protocol = replace(make_protocol(), rows=32, cols=32, pixel_mm=4.0)
    radiograph = simulate(
        make_scene(make_ball(60.0, at=(0.0, resolve_view(protocol).centre_mm[1], 0.0))), protocol, engine=engine
    )
    assert radiograph.audit["unrepaired"] == 0
    assert radiograph.pixels.min() < radiograph.pixels.max()


def test_the_ambient_path_ends_at_the_source_and_the_detector(engine):
    scene = make_scene(make_ball(1500.0, at=(0.0, -300.0, 0.0)))
    paths = trace(scene, make_view(), engine=engine, materials=("air", "water"), precision="float64")
    length = np.linalg.norm(compute_rays(make_view())[1], axis=-1)
    assert_allclose(paths.path_mm["air"] + paths.path_mm["water"], length, rtol=1e-9)
    assert_allclose(paths.path_mm["water"], length, rtol=1e-9)
    assert compute_box_length(scene.bounds_mm, make_view()).max() > 1000
