"""Check the ray caster: exact chords of convex polyhedra, closed forms, invariants and agreement of both engines."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from numpy.testing import assert_allclose

from pssf.core.checks import InputError
from pssf.geometry.scene import Scene, Surface
from pssf.geometry.view import View, resolve_view
from pssf.model.protocol import Protocol, load_protocol
from pssf.raycast import Audit, trace
from pssf.raycast.engines import embree, scanline
from pssf.raycast.engines.neighbour_reuse import find_adjacent_faces
from pssf.raycast.engines.projected_surface import BAND_ROWS, project_surface
from pssf.raycast.path_lengths import sum_audits

ENGINES = ("embree", "scanline")
few = settings(max_examples=12)
positions = st.tuples(*3 * [st.floats(-15, 15)])
rotations = st.tuples(*3 * [st.floats(-180, 180)])


def make_protocol(rows=96, cols=80, pixel_mm=1.7, **changes) -> Protocol:
    return replace(load_protocol("reference"), rows=rows, cols=cols, pixel_mm=pixel_mm, **changes)


def move_mesh(mesh, at=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0)):
    placed = mesh.copy()
    placed.apply_transform(trimesh.transformations.euler_matrix(*np.deg2rad(turn_deg)))
    placed.apply_translation(at)
    return placed


def make_ball(radius_mm, subdivisions=3, **pose):
    return move_mesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm), **pose)


def make_box(*extents_mm, **pose):
    return move_mesh(trimesh.creation.box(extents=extents_mm), **pose)


def make_rough_ball(seed, radius_mm=25.0):
    """Make a closed, non-convex ball with a random radius at every vertex, which has slivers and folds."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    scale = np.random.default_rng(seed).uniform(0.4, 1.6, (len(mesh.vertices), 1))
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)


def make_scene(mesh, material="water"):
    return Scene([Surface(mesh, material, "air", name="thing")])


def compute_rays(view):
    """Compute the source (3,) and the vectors (rows, cols, 3) from source to pixels from the definition of the view."""
    direction = np.empty((view.rows, view.cols, 3))
    direction[..., 0] = view.centre_mm[0] + (np.arange(view.cols) - (view.cols - 1) / 2) * view.pixel_mm
    direction[..., 1] = view.centre_mm[1]
    direction[..., 2] = (view.centre_mm[2] - (np.arange(view.rows) - (view.rows - 1) / 2) * view.pixel_mm)[:, None]
    return np.array(view.source_mm), direction - view.source_mm


def compute_convex_chord(mesh, view):
    """Compute chords (rows, cols) by clipping every ray against the half-spaces of all faces, in float64."""
    source, direction = compute_rays(view)
    corners = mesh.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return _clip_rays(normals, ((corners[:, 0] - source) * normals).sum(axis=1), direction)


@njit(error_model="numpy")
def _clip_rays(normals, heights, direction):
    chord = np.zeros(direction.shape[:2])
    for row in range(chord.shape[0]):
        for col in range(chord.shape[1]):
            x, y, z = direction[row, col]
            near, far = 0.0, 1.0
            for k in range(len(heights)):
                slope = normals[k, 0] * x + normals[k, 1] * y + normals[k, 2] * z
                if slope < 0.0:
                    near = max(near, heights[k] / slope)
                elif slope > 0.0:
                    far = min(far, heights[k] / slope)
                elif heights[k] < 0.0:
                    far = -1.0
                if near >= far:
                    break
            chord[row, col] = max(far - near, 0.0) * np.sqrt(x * x + y * y + z * z)
    return chord


def compute_box_length(bounds, view):
    """Compute the length (rows, cols) of every ray inside an axis-parallel box."""
    source, direction = compute_rays(view)
    with np.errstate(divide="ignore"):
        one, other = (bounds[0] - source) / direction, (bounds[1] - source) / direction
    near = np.minimum(one, other).max(axis=-1)
    return np.maximum(np.maximum(one, other).min(axis=-1) - near, 0.0) * np.linalg.norm(direction, axis=-1)


def assert_clean(audit):
    assert audit.unrepaired == 0
    assert audit.repaired == audit.unbalanced + audit.imprecise


ACCEPTANCE = {
    "a sphere": make_ball(52.0, at=(3.0, -2.0, 5.0)),
    "a box": make_box(60.0, 80.0, 70.0),
    "a rotated box": make_box(60.0, 50.0, 70.0, turn_deg=(20.0, 33.0, 47.0)),
    "an oblique cylinder": move_mesh(
        trimesh.creation.cylinder(radius=25, height=110, sections=128), turn_deg=(35, 25, 10)
    ),
}
LARGE = make_protocol(rows=1024, cols=1024, pixel_mm=0.15)

# Tolerance for stored path lengths: the rounding error of float32 between 64 and 128 mm is 3.8e-6 mm.
STORED_MM = 5e-6


@pytest.mark.parametrize("mesh", ACCEPTANCE.values(), ids=ACCEPTANCE)
def test_both_engines_give_the_exact_chord_of_a_convex_solid(mesh):
    exact = compute_convex_chord(mesh, resolve_view(LARGE))
    assert exact.max() > 49.0
    for engine in ENGINES:
        paths = trace(make_scene(mesh), LARGE, engine=engine)
        assert np.abs(paths.path_mm["water"] - exact).max() < STORED_MM
        assert_clean(paths.audit)
        assert paths.audit.repaired < 0.01 * paths.audit.rays


def test_both_engines_give_the_exact_chords_of_nested_spheres():
    meshes = {
        "muscle": make_ball(50.0),
        "cortical_bone": make_ball(40.0, turn_deg=(7, 8, 9)),
        "marrow": make_ball(25.0, at=(5, -8, 2)),
    }
    chords = [compute_convex_chord(mesh, resolve_view(LARGE)) for mesh in meshes.values()] + [0.0]
    outside = ["air", *meshes]
    scene = Scene([Surface(mesh, name, outside[i], name) for i, (name, mesh) in enumerate(meshes.items())])
    for engine in ENGINES:
        paths = trace(scene, LARGE, engine=engine)
        assert list(paths.path_mm) == list(meshes)
        assert_clean(paths.audit)
        for k, path_mm in enumerate(paths.path_mm.values()):
            assert path_mm.dtype == np.float32
            assert np.abs(path_mm - (chords[k] - chords[k + 1])).max() < STORED_MM


@pytest.mark.parametrize("engine", ENGINES)
@few
@given(at=positions, turn=rotations, seed=st.integers(0, 2**31))
def test_path_lengths_of_all_materials_sum_to_the_length_in_the_box(engine, at, turn, seed):
    shell, core = make_rough_ball(seed, 15.0), make_rough_ball(seed, 8.0)
    limb = move_mesh(make_box(50, 50, 56), at, turn)
    scene = Scene(
        [
            Surface(limb, "muscle", "air"),
            Surface(move_mesh(shell, at, turn), "cortical_bone", "muscle"),
            Surface(move_mesh(core, at, turn), "marrow", "cortical_bone"),
            Surface(make_ball(12.0, at=(5.0, 90.0, -20.0)), "Ti@4.51", "air"),
        ]
    )
    protocol = make_protocol()
    paths = trace(scene, protocol, engine=engine, materials=scene.materials)
    assert_clean(paths.audit)
    assert list(paths.path_mm) == ["air", "muscle", "cortical_bone", "marrow", "Ti@4.51"]
    whole = sum(path_mm.astype(np.float64) for path_mm in paths.path_mm.values())
    assert_allclose(whole, compute_box_length(scene.bounds_mm, resolve_view(protocol)), atol=1e-4)
    assert min(path_mm.min() for path_mm in paths.path_mm.values()) > -1e-4
    assert all(path_mm.max() > 1.0 for path_mm in paths.path_mm.values())


@few
@given(seed=st.integers(0, 2**31), at=positions, turn=rotations)
def test_the_engines_agree_on_folded_and_spiky_solids(seed, at, turn):
    scene, protocol = (
        make_scene(move_mesh(make_rough_ball(seed), at, turn)),
        make_protocol(rows=150, cols=170, pixel_mm=0.7),
    )
    cast, scanned = (trace(scene, protocol, engine=engine) for engine in ENGINES)
    assert_allclose(cast.path_mm["water"], scanned.path_mm["water"], rtol=0, atol=1e-5)
    assert cast.path_mm["water"].max() > 10.0
    assert_clean(cast.audit)


@pytest.mark.parametrize("engine", ENGINES)
@few
@given(order=st.permutations(range(4)))
def test_the_order_of_the_surfaces_does_not_matter(engine, order):
    surfaces = [
        Surface(make_ball(20.0, at=(-30.0, 0.0, 0.0)), "marrow", "air"),
        Surface(make_box(30.0, 20.0, 40.0, at=(30.0, 5.0, 0.0)), "marrow", "air"),
        Surface(make_ball(9.0, at=(-30.0, 0.0, 0.0)), "water", "marrow"),
        Surface(make_rough_ball(3, 15.0), "marrow", "air"),
    ]
    straight = trace(Scene(surfaces), make_protocol(), engine=engine)
    shuffled = trace(Scene([surfaces[k] for k in order]), make_protocol(), engine=engine)
    assert shuffled.audit == straight.audit
    for name, path_mm in straight.path_mm.items():
        assert_allclose(shuffled.path_mm[name], path_mm, rtol=0, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
@few
@given(shift=st.tuples(*3 * [st.floats(-500, 500)]), seed=st.integers(0, 2**31))
def test_moving_source_scene_and_detector_together_changes_nothing(engine, shift, seed):
    view = resolve_view(make_protocol(beam_angle_deg=7.0))
    source, centre = (tuple(np.add(point, shift).tolist()) for point in (view.source_mm, view.centre_mm))
    shifted_view = replace(view, source_mm=source, centre_mm=centre)
    mesh = make_rough_ball(seed)
    one = trace(make_scene(mesh), view, engine=engine).path_mm["water"]
    other = trace(make_scene(move_mesh(mesh, shift)), shifted_view, engine=engine).path_mm["water"]
    assert_allclose(other, one, rtol=0, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "mesh", [make_ball(30.0), make_rough_ball(11), make_box(30, 40, 50, turn_deg=(10, 20, 30))], ids=str
)
def test_parallel_chords_times_pixel_area_give_the_volume(engine, mesh):
    far = View(source_mm=(0.0, -1e7, 0.0), centre_mm=(0.0, 100.0, 0.0), rows=450, cols=450, pixel_mm=0.21)
    path_mm = trace(make_scene(mesh), far, engine=engine).path_mm["water"]
    # The sum over 450 x 450 pixel centres has an error below 0.1 %, from pixels on folds.
    assert path_mm.sum(dtype=np.float64) * far.pixel_mm**2 == pytest.approx(mesh.volume, rel=5e-4)


HALVED = View(source_mm=(0.0, -512.0, 0.0), centre_mm=(0.0, 512.0, 0.0), rows=65, cols=65, pixel_mm=1.0)


def make_frustum(rows, cols, depths=(0.45, 0.55)):
    """Make a frustum between two rows and two columns of HALVED; the sides are parallel to the rays."""
    pixels = [(s, r, c) for s in depths for r in rows for c in cols]
    points = [(s * (c - 32.0), s * 1024.0 - 512.0, s * (32.0 - r)) for s, r, c in pixels]
    return trimesh.Trimesh(points, process=False).convex_hull


@pytest.mark.parametrize("engine", ENGINES)
def test_a_box_with_its_edges_on_pixel_centres_is_counted_once(engine):
    # Integer sizes and a magnification of a power of two project the front edges exactly onto pixel centres.
    mesh = trimesh.creation.box(bounds=[[-8, 0, -8], [8, 8, 8]])
    paths = trace(make_scene(mesh), HALVED, engine=engine)
    assert_allclose(paths.path_mm["water"], compute_convex_chord(mesh, HALVED), rtol=0, atol=1e-5)
    assert_clean(paths.audit)


@pytest.mark.parametrize("engine", ENGINES)
def test_chords_along_parallel_sides_are_between_zero_and_the_depth(engine):
    paths = trace(make_scene(make_frustum((20, 44), (16, 32))), HALVED, engine=engine)
    fraction = paths.path_mm["water"] / (np.linalg.norm(compute_rays(HALVED)[1], axis=-1) * 0.1)
    assert_allclose(fraction[21:44, 17:32], 1.0, atol=1e-6)
    assert -1e-6 < fraction.min() <= fraction.max() < 1 + 1e-6
    fraction[20:45, 16:33] = 0.0
    assert not fraction.any()
    assert_clean(paths.audit)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("off_px", [-1e-3, -1e-5, -1e-7, 1e-7, 1e-5, 1e-3])
def test_pixels_next_to_a_side_parallel_to_the_rays_are_exact(engine, off_px):
    # The smallest offset of 1e-7 pixels is a hundredth of the float32 resolution at these coordinates.
    mesh = make_frustum((20 - off_px, 44 + off_px), (16 - off_px, 32 + off_px))
    paths = trace(make_scene(mesh), HALVED, engine=engine)
    inside = np.s_[20:45, 16:33] if off_px > 0 else np.s_[21:44, 17:32]
    expected = np.zeros((65, 65))
    expected[inside] = np.linalg.norm(compute_rays(HALVED)[1], axis=-1)[inside] * 0.1
    assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-4)
    assert_clean(paths.audit)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_thin_edge_is_exact_although_float32_misses_entry_and_exit(engine):
    # A blade 512 mm deep and 0.05 pixels wide; the edge is 1e-7 pixels beyond column 40.
    pixels = [
        (s, r, c) for r in (-400.3, 450.7) for s, c in ((0.5, 40 + 1e-7), (0.5, 39.9), (0.25, 39.95), (0.75, 39.95))
    ]
    points = [(s * (c - 32.0), s * 1024.0 - 512.0, s * (32.0 - r)) for s, r, c in pixels]
    blade = trimesh.Trimesh(points, process=False).convex_hull
    for seed in range(10):
        shift = np.random.default_rng(seed).uniform(-50, 50, 3)
        source, centre = (tuple(np.add(point, shift).tolist()) for point in (HALVED.source_mm, HALVED.centre_mm))
        view, mesh = replace(HALVED, source_mm=source, centre_mm=centre), move_mesh(blade, shift)
        exact = compute_convex_chord(mesh, view)
        assert exact[:, 40].min() > 1.2e-3
        assert_allclose(trace(make_scene(mesh), view, engine=engine).path_mm["water"], exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, 4096), (4096, 1), (BAND_ROWS + 1, 7)])
def test_detectors_of_unusual_shape_are_exact(engine, rows, cols):
    protocol = make_protocol(rows=rows, cols=cols, pixel_mm=0.05)
    mesh = make_ball(40.0, subdivisions=2, at=(1.0, 2.0, 3.0))
    paths = trace(make_scene(mesh), protocol, engine=engine)
    assert paths.path_mm["water"].shape == (rows, cols)
    assert_allclose(paths.path_mm["water"], compute_convex_chord(mesh, resolve_view(protocol)), rtol=0, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_surfaces_are_clipped_at_the_border_of_the_detector(engine):
    protocol = make_protocol(rows=40, cols=50, pixel_mm=0.5)
    across, beside = make_ball(30.0, at=(12.0, 0.0, -9.0)), make_ball(10.0, at=(60.0, 0.0, 0.0))
    scene = Scene([Surface(across, "water", "air"), Surface(beside, "marrow", "air")])
    paths = trace(scene, protocol, engine=engine)
    assert_allclose(paths.path_mm["water"], compute_convex_chord(across, resolve_view(protocol)), rtol=0, atol=1e-5)
    assert not paths.path_mm["marrow"].any()


@pytest.mark.parametrize("engine", ENGINES)
def test_path_lengths_do_not_depend_on_the_number_of_workers(engine):
    scene = Scene(
        [Surface(make_rough_ball(5, 30.0), "muscle", "air"), Surface(make_rough_ball(6, 8.0), "marrow", "muscle")]
    )
    one, two, five = (trace(scene, make_protocol(300, 200, 0.5), engine=engine, workers=n) for n in (1, 2, 5))
    assert one.audit == two.audit == five.audit
    for name, path_mm in one.path_mm.items():
        assert path_mm.tobytes() == two.path_mm[name].tobytes() == five.path_mm[name].tobytes()


def test_a_mesh_with_a_cavity_wound_inwards_is_hollow():
    outer, cavity = make_ball(30.0), make_ball(20.0)
    cavity.invert()
    hollow = trimesh.util.concatenate([outer, cavity])
    expected = compute_convex_chord(make_ball(30.0), resolve_view(make_protocol())) - compute_convex_chord(
        make_ball(20.0), resolve_view(make_protocol())
    )
    for engine in ENGINES:
        paths = trace(make_scene(hollow), make_protocol(), engine=engine)
        assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-5)


def test_only_the_requested_materials_are_returned_in_their_order():
    scene = Scene([Surface(make_ball(30.0), "muscle", "air"), Surface(make_ball(20.0), "marrow", "muscle")])
    assert list(trace(scene, make_protocol()).path_mm) == ["muscle", "marrow"]
    paths = trace(scene, make_protocol(), materials=("marrow", "air"))
    assert list(paths.path_mm) == ["marrow", "air"]
    box_mm = compute_box_length(scene.bounds_mm, resolve_view(make_protocol()))
    assert_allclose(
        paths.path_mm["air"],
        box_mm - compute_convex_chord(make_ball(30.0), resolve_view(make_protocol())),
        rtol=0,
        atol=1e-4,
    )


def test_the_audit_counts_the_rays_that_each_engine_traces():
    view = resolve_view(make_protocol())
    sheet = project_surface(make_scene(make_ball(30.0)).surfaces[0].solid, view)
    pixels = (sheet.rows[1] - sheet.rows[0]) * (sheet.cols[1] - sheet.cols[0])
    crossing = np.count_nonzero(trace(make_scene(make_ball(30.0)), view).path_mm["water"])
    for engine, rays in (("scanline", pixels), ("embree", crossing)):
        audit = trace(make_scene(make_ball(30.0)), view, engine=engine).audit
        assert audit.counts()["rays"] == audit.rays == rays
    assert list(audit.counts()) == ["rays", "unbalanced", "imprecise", "repaired", "unrepaired"]
    assert sum_audits([Audit(rays=2, repaired=1), Audit(rays=3)]) == Audit(rays=5, repaired=1)


def count_embree_rays(monkeypatch):
    """Record the number of rays in each subsequent call of Embree."""
    counts = []

    class Counting(embree.EmbreeScene):
        def run(self, origins, directions, **options):
            counts.append(len(origins))
            return super().run(origins, directions, **options)

    monkeypatch.setattr(embree, "EmbreeScene", Counting)
    return counts


def count_mean_crossings(mesh, view, step=16):
    """Compute the mean number of crossings per ray that crosses a mesh, using every `step`-th row and column."""
    source, direction = compute_rays(view)
    direction = direction[::step, ::step].reshape(-1, 3)
    found = mesh.ray.intersects_location(np.broadcast_to(source, direction.shape), direction, multiple_hits=True)[1]
    return len(found) / len(np.unique(found))


@pytest.mark.parametrize(
    "mesh", [make_ball(50.0, subdivisions=2), make_rough_ball(3)], ids=["large triangles", "folds and slivers"]
)
def test_rays_that_reuse_the_triangles_of_a_neighbour_are_exact(monkeypatch, mesh):
    fine = make_protocol(rows=512, cols=512, pixel_mm=0.3)
    exact = trace(make_scene(mesh), fine, engine="scanline", precision="float64").path_mm["water"]
    crossed = count_mean_crossings(mesh, resolve_view(fine))
    counts = count_embree_rays(monkeypatch)
    paths = trace(make_scene(mesh), fine, engine="embree", precision="float64")
    # Without reuse, each ray would be cast once per crossing and a final time.
    assert sum(counts) < 0.7 * crossed * paths.audit.rays
    assert_allclose(paths.path_mm["water"], exact, rtol=0, atol=1e-9)
    assert_clean(paths.audit)


def test_rays_through_small_triangles_continue_in_adjacent_triangles(monkeypatch):
    # Triangles cover about 3 pixels, so a ray rarely crosses the same triangles as the cast ray 5 pixels away.
    mesh, fine = make_ball(50.0, subdivisions=6), make_protocol(rows=512, cols=512, pixel_mm=0.3)
    exact = trace(make_scene(mesh), fine, engine="scanline", precision="float64").path_mm["water"]
    counts = count_embree_rays(monkeypatch)
    paths = trace(make_scene(mesh), fine, engine="embree", precision="float64")
    assert sum(counts) < 0.3 * paths.audit.rays
    assert_allclose(paths.path_mm["water"], exact, rtol=0, atol=1e-9)
    assert_clean(paths.audit)


@pytest.mark.parametrize("open_at", [None, 5])
def test_adjacent_faces_contain_their_edge_in_opposite_directions(open_at):
    faces = np.asarray(make_ball(1.0, subdivisions=2).faces, np.int32)
    faces = faces if open_at is None else np.delete(faces, open_at, axis=0)
    edges = {(face[k], face[(k + 1) % 3]): number for number, face in enumerate(faces.tolist()) for k in range(3)}
    wanted = [[edges.get((face[(k + 1) % 3], face[k]), -1) for k in range(3)] for face in faces.tolist()]
    across = find_adjacent_faces(faces, int(faces.max()) + 1)
    np.testing.assert_array_equal(across, wanted)
    assert np.count_nonzero(across < 0) == (0 if open_at is None else 3)


@pytest.mark.parametrize("count", [200, 3])
def test_parallel_plates_are_exact_and_repaired_once_per_band(monkeypatch, count):
    # Face diagonals pass through pixel centres, so many rays are uncertain.
    plates = [make_box(150.0, 0.2, 150.0, at=(0.0, 0.5 * k - 50.0, 0.0)) for k in range(count)]
    protocol = make_protocol(rows=96, cols=96, pixel_mm=1.0)
    expected = sum(compute_convex_chord(plate, resolve_view(protocol)) for plate in plates)
    calls, spans = [], scanline._find_spans
    monkeypatch.setattr(scanline, "_find_spans", lambda *arguments: calls.append(1) or spans(*arguments))
    scene = Scene([Surface(plate, "cortical_bone", "air") for plate in plates])
    paths = trace(scene, protocol, engine="embree", precision="float64")
    assert_allclose(paths.path_mm["cortical_bone"], expected, rtol=0, atol=1e-9)
    assert paths.audit.repaired > 50 * count
    assert_clean(paths.audit)
    # One pass counts crossings and one pass repairs all uncertain rays.
    assert len(calls) <= 2 * count * (96 // BAND_ROWS)


def test_rays_beyond_the_hit_limit_are_repaired_to_the_same_path_lengths(monkeypatch):
    expected = trace(make_scene(make_rough_ball(8)), make_protocol()).path_mm["water"]
    monkeypatch.setattr(embree, "HIT_LIMIT", 1)
    paths = trace(make_scene(make_rough_ball(8)), make_protocol())
    assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-5)
    assert paths.audit.repaired == paths.audit.imprecise >= np.count_nonzero(expected)
    assert_clean(paths.audit)


def test_a_ray_with_a_missing_crossing_is_counted_and_repaired(monkeypatch):
    class Forgetful(embree.EmbreeScene):
        """Embree with every fiftieth hit removed."""

        def run(self, origins, directions, **options):
            hit = super().run(origins, directions, **options)
            hit["primID"][np.arange(len(origins)) % 50 == 0] = -1
            return hit

    fine = make_protocol(rows=384, cols=320, pixel_mm=0.425)  # Embree casts a few percent of these rays
    expected = trace(make_scene(make_ball(30.0)), fine).path_mm["water"]
    monkeypatch.setattr(embree, "EmbreeScene", Forgetful)
    paths = trace(make_scene(make_ball(30.0)), fine)
    assert paths.audit.unbalanced > 10
    assert_clean(paths.audit)
    assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-5)


def test_winding_numbers_of_a_surface_sum_to_zero_on_every_row():
    sheet = project_surface(make_scene(make_rough_ball(9)).surfaces[0].solid, resolve_view(make_protocol()))
    for row in range(*sheet.rows):
        assert not scanline.sum_windings(sheet, row, row + 1).any()


class Broken:
    """A density field that returns NaN."""

    def integrate(self, starts_mm, ends_mm):
        return np.full(len(starts_mm), np.nan)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_error_for_a_density_that_returns_nan_names_its_surfaces(engine):
    broken = Broken()
    shell = Surface(make_ball(30.0), "water", "air", "shell", inside_density=broken)
    core = Surface(make_ball(20.0), "muscle", "water", "core", outside_density=broken)
    gave_nan = r"^shell(, core)?: density of water: Broken.integrate must return .*, got nan for \d+ segments"
    with pytest.raises(InputError, match=gave_nan):
        trace(Scene([shell, core]), make_protocol(), engine=engine)
    assert trace(Scene([shell, core]), make_protocol(), engine=engine, texture=False).path_mm["water"].max() > 10


def test_path_lengths_are_compared_by_content_and_printed_in_short():
    scene = make_scene(make_ball(30.0))
    paths, again = (trace(scene, make_protocol()) for _ in range(2))
    assert paths.scene is scene
    assert paths == again
    assert hash(paths) == hash(again)
    assert paths != trace(make_scene(make_ball(30.0)), make_protocol())
    assert paths != trace(scene, make_protocol(rows=95))
    assert paths != trace(scene, make_protocol(), materials=["air", "water"])
    other = replace(paths, path_mm={"water": paths.path_mm["water"] + 1})
    assert paths != other
    assert paths != "paths"
    assert repr(paths).startswith("Paths(water: (96, 80) mm, Audit(rays=")
    assert "array" not in repr(paths)


def test_embree_casts_a_scene_of_more_than_a_thousand_surfaces():
    mesh = trimesh.creation.icosahedron()
    mesh.apply_scale(30.0)
    surfaces = [Surface(mesh, "water", "water", f"number {k}") for k in range(1500)]
    scene = Scene([Surface(mesh, "water", "air"), *surfaces])
    paths = trace(scene, make_protocol(rows=2, cols=2, pixel_mm=3.0))
    assert_allclose(
        paths.path_mm["water"], compute_convex_chord(mesh, resolve_view(make_protocol(2, 2, 3.0))), rtol=0, atol=1e-5
    )


def test_unknown_engines_materials_and_workers_raise_an_error():
    scene = make_scene(make_ball(10.0))
    for materials in ("water", 3):
        with pytest.raises(InputError, match=f"materials must be a list with names from air, water, got {materials!r}"):
            trace(scene, make_protocol(), materials=materials)
    with pytest.raises(InputError, match=r"material must be one of air, water, got \['water'\]"):
        trace(scene, make_protocol(), materials=[["water"]])
    with pytest.raises(InputError, match="texture must be one of True, False, got 'none'"):
        trace(scene, make_protocol(), texture="none")
    with pytest.raises(InputError, match=r"engine must be one of .*, got 'embre' \(did you mean 'embree'\?\)"):
        trace(scene, make_protocol(), engine="embre")
    with pytest.raises(InputError, match="material must be one of air, water, got 'watre'"):
        trace(scene, make_protocol(), materials=["watre"])
    with pytest.raises(InputError, match="precision must be one of float32, float64, got 'double'"):
        trace(scene, make_protocol(), precision="double")
    with pytest.raises(InputError, match=r"workers must be .*, got 0"):
        trace(scene, make_protocol(), workers=0)
