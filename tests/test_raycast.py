"""Ray caster: exact chords of convex polyhedra, closed forms, invariants, and the agreement of two engines."""

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
places = st.tuples(*3 * [st.floats(-15, 15)])
turns = st.tuples(*3 * [st.floats(-180, 180)])


def detector(rows=96, cols=80, pixel_mm=1.7, **changes) -> Protocol:
    return replace(load_protocol("reference"), rows=rows, cols=cols, pixel_mm=pixel_mm, **changes)


def moved(mesh, at=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0)):
    placed = mesh.copy()
    placed.apply_transform(trimesh.transformations.euler_matrix(*np.deg2rad(turn_deg)))
    placed.apply_translation(at)
    return placed


def ball(radius_mm, subdivisions=3, **place):
    return moved(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm), **place)


def box(*extents_mm, **place):
    return moved(trimesh.creation.box(extents=extents_mm), **place)


def rough(seed, radius_mm=25.0):
    """A ball with a random radius at every vertex: closed, far from convex, full of slivers and folds."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    scale = np.random.default_rng(seed).uniform(0.4, 1.6, (len(mesh.vertices), 1))
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)


def alone(mesh, material="water"):
    return Scene([Surface(mesh, material, "air", name="thing")])


def rays(view):
    """(3,) source and (rows, cols, 3) from source to pixel, by the definition of the view."""
    way = np.empty((view.rows, view.cols, 3))
    way[..., 0] = view.centre_mm[0] + (np.arange(view.cols) - (view.cols - 1) / 2) * view.pixel_mm
    way[..., 1] = view.centre_mm[1]
    way[..., 2] = (view.centre_mm[2] - (np.arange(view.rows) - (view.rows - 1) / 2) * view.pixel_mm)[:, None]
    return np.array(view.source_mm), way - view.source_mm


def convex_chord(mesh, view):
    """(rows, cols) chord by clipping every ray against the half-spaces of all faces, in float64."""
    source, way = rays(view)
    corners = mesh.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return _clipped(normals, ((corners[:, 0] - source) * normals).sum(axis=1), way)


@njit(error_model="numpy")
def _clipped(normals, heights, way):
    chord = np.zeros(way.shape[:2])
    for row in range(chord.shape[0]):
        for col in range(chord.shape[1]):
            x, y, z = way[row, col]
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


def box_length(bounds, view):
    """(rows, cols) length of every ray inside an axis-parallel box."""
    source, way = rays(view)
    with np.errstate(divide="ignore"):
        one, other = (bounds[0] - source) / way, (bounds[1] - source) / way
    near = np.minimum(one, other).max(axis=-1)
    return np.maximum(np.maximum(one, other).min(axis=-1) - near, 0.0) * np.linalg.norm(way, axis=-1)


def assert_clean(audit):
    assert audit.unrepaired == 0
    assert audit.repaired == audit.unbalanced + audit.imprecise


ACCEPTANCE = {
    "a sphere": ball(52.0, at=(3.0, -2.0, 5.0)),
    "a box": box(60.0, 80.0, 70.0),
    "a turned box": box(60.0, 50.0, 70.0, turn_deg=(20.0, 33.0, 47.0)),
    "an oblique cylinder": moved(trimesh.creation.cylinder(radius=25, height=110, sections=128), turn_deg=(35, 25, 10)),
}
LARGE = detector(rows=1024, cols=1024, pixel_mm=0.15)

# Half the spacing of float32 from 64 to 128 mm is 3.8e-6 mm: the results are exact but for their storage.
STORED_MM = 5e-6


@pytest.mark.parametrize("mesh", ACCEPTANCE.values(), ids=ACCEPTANCE)
def test_both_engines_give_the_exact_chord_of_a_convex_solid_at_every_pixel(mesh):
    exact = convex_chord(mesh, resolve_view(LARGE))
    assert exact.max() > 49.0
    for engine in ENGINES:
        paths = trace(alone(mesh), LARGE, engine=engine)
        assert np.abs(paths.path_mm["water"] - exact).max() < STORED_MM
        assert_clean(paths.audit)
        assert paths.audit.repaired < 0.01 * paths.audit.rays


def test_both_engines_give_the_exact_chords_of_nested_spheres_of_different_materials():
    meshes = {
        "muscle": ball(50.0),
        "cortical_bone": ball(40.0, turn_deg=(7, 8, 9)),
        "marrow": ball(25.0, at=(5, -8, 2)),
    }
    chords = [convex_chord(mesh, resolve_view(LARGE)) for mesh in meshes.values()] + [0.0]
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
@given(at=places, turn=turns, seed=st.integers(0, 2**31))
def test_paths_in_all_materials_and_air_add_up_to_the_length_inside_the_box(engine, at, turn, seed):
    shell, core = rough(seed, 15.0), rough(seed, 8.0)
    limb = moved(box(50, 50, 56), at, turn)
    scene = Scene(
        [
            Surface(limb, "muscle", "air"),
            Surface(moved(shell, at, turn), "cortical_bone", "muscle"),
            Surface(moved(core, at, turn), "marrow", "cortical_bone"),
            Surface(ball(12.0, at=(5.0, 90.0, -20.0)), "Ti@4.51", "air"),
        ]
    )
    protocol = detector()
    paths = trace(scene, protocol, engine=engine, materials=scene.materials)
    assert_clean(paths.audit)
    assert list(paths.path_mm) == ["air", "muscle", "cortical_bone", "marrow", "Ti@4.51"]
    whole = sum(path_mm.astype(np.float64) for path_mm in paths.path_mm.values())
    assert_allclose(whole, box_length(scene.bounds_mm, resolve_view(protocol)), atol=1e-4)
    assert min(path_mm.min() for path_mm in paths.path_mm.values()) > -1e-4
    assert all(path_mm.max() > 1.0 for path_mm in paths.path_mm.values())


@few
@given(seed=st.integers(0, 2**31), at=places, turn=turns)
def test_the_engines_agree_on_folded_and_spiky_solids(seed, at, turn):
    scene, protocol = alone(moved(rough(seed), at, turn)), detector(rows=150, cols=170, pixel_mm=0.7)
    cast, scanned = (trace(scene, protocol, engine=engine) for engine in ENGINES)
    assert_allclose(cast.path_mm["water"], scanned.path_mm["water"], rtol=0, atol=1e-5)
    assert cast.path_mm["water"].max() > 10.0
    assert_clean(cast.audit)


@pytest.mark.parametrize("engine", ENGINES)
@few
@given(order=st.permutations(range(4)))
def test_the_order_of_the_surfaces_does_not_matter(engine, order):
    surfaces = [
        Surface(ball(20.0, at=(-30.0, 0.0, 0.0)), "marrow", "air"),
        Surface(box(30.0, 20.0, 40.0, at=(30.0, 5.0, 0.0)), "marrow", "air"),
        Surface(ball(9.0, at=(-30.0, 0.0, 0.0)), "water", "marrow"),
        Surface(rough(3, 15.0), "marrow", "air"),
    ]
    straight = trace(Scene(surfaces), detector(), engine=engine)
    shuffled = trace(Scene([surfaces[k] for k in order]), detector(), engine=engine)
    assert shuffled.audit == straight.audit
    for name, path_mm in straight.path_mm.items():
        assert_allclose(shuffled.path_mm[name], path_mm, rtol=0, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
@few
@given(shift=st.tuples(*3 * [st.floats(-500, 500)]), seed=st.integers(0, 2**31))
def test_moving_source_scene_and_detector_together_changes_nothing(engine, shift, seed):
    here = resolve_view(detector(beam_angle_deg=7.0))
    source, centre = (tuple(np.add(place, shift).tolist()) for place in (here.source_mm, here.centre_mm))
    there = replace(here, source_mm=source, centre_mm=centre)
    mesh = rough(seed)
    one = trace(alone(mesh), here, engine=engine).path_mm["water"]
    other = trace(alone(moved(mesh, shift)), there, engine=engine).path_mm["water"]
    assert_allclose(other, one, rtol=0, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("mesh", [ball(30.0), rough(11), box(30, 40, 50, turn_deg=(10, 20, 30))], ids=str)
def test_parallel_chords_times_pixel_area_give_the_volume(engine, mesh):
    far = View(source_mm=(0.0, -1e7, 0.0), centre_mm=(0.0, 100.0, 0.0), rows=450, cols=450, pixel_mm=0.21)
    path_mm = trace(alone(mesh), far, engine=engine).path_mm["water"]
    # 450 x 450 midpoints: the error of the sum is that of pixels on folds, well under a part in a thousand.
    assert path_mm.sum(dtype=np.float64) * far.pixel_mm**2 == pytest.approx(mesh.volume, rel=5e-4)


HALVED = View(source_mm=(0.0, -512.0, 0.0), centre_mm=(0.0, 512.0, 0.0), rows=65, cols=65, pixel_mm=1.0)


def beam(rows, cols, depths=(0.45, 0.55)):
    """A frustum along the rays of HALVED, seen between two rows and two columns: its sides are edge-on to the rays."""
    pixels = [(s, r, c) for s in depths for r in rows for c in cols]
    points = [(s * (c - 32.0), s * 1024.0 - 512.0, s * (32.0 - r)) for s, r, c in pixels]
    return trimesh.Trimesh(points, process=False).convex_hull


@pytest.mark.parametrize("engine", ENGINES)
def test_a_box_with_its_edges_on_pixel_centres_is_counted_once(engine):
    # Whole sizes and a power of two in magnification: its front is seen exactly on pixel rows and columns.
    mesh = trimesh.creation.box(bounds=[[-8, 0, -8], [8, 8, 8]])
    paths = trace(alone(mesh), HALVED, engine=engine)
    assert_allclose(paths.path_mm["water"], convex_chord(mesh, HALVED), rtol=0, atol=1e-5)
    assert_clean(paths.audit)


@pytest.mark.parametrize("engine", ENGINES)
def test_on_sides_seen_edge_on_the_chord_is_between_nothing_and_all(engine):
    paths = trace(alone(beam((20, 44), (16, 32))), HALVED, engine=engine)
    share = paths.path_mm["water"] / (np.linalg.norm(rays(HALVED)[1], axis=-1) * 0.1)
    assert_allclose(share[21:44, 17:32], 1.0, atol=1e-6)
    assert -1e-6 < share.min() <= share.max() < 1 + 1e-6
    share[20:45, 16:33] = 0.0
    assert not share.any()
    assert_clean(paths.audit)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("off_px", [-1e-3, -1e-5, -1e-7, 1e-7, 1e-5, 1e-3])
def test_pixels_a_hair_beside_an_edge_on_side_are_on_the_right_side_of_it(engine, off_px):
    # A ten-millionth of a pixel is a hundredth of what float32 resolves here.
    mesh = beam((20 - off_px, 44 + off_px), (16 - off_px, 32 + off_px))
    paths = trace(alone(mesh), HALVED, engine=engine)
    inside = np.s_[20:45, 16:33] if off_px > 0 else np.s_[21:44, 17:32]
    expected = np.zeros((65, 65))
    expected[inside] = np.linalg.norm(rays(HALVED)[1], axis=-1)[inside] * 0.1
    assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-4)
    assert_clean(paths.audit)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_edge_of_a_blade_is_exact_where_float32_misses_entry_and_exit_both(engine):
    # 512 mm deep and a twentieth of a pixel wide; column 40 is inside its edge by a ten-millionth of a pixel.
    pixels = [
        (s, r, c) for r in (-400.3, 450.7) for s, c in ((0.5, 40 + 1e-7), (0.5, 39.9), (0.25, 39.95), (0.75, 39.95))
    ]
    points = [(s * (c - 32.0), s * 1024.0 - 512.0, s * (32.0 - r)) for s, r, c in pixels]
    blade = trimesh.Trimesh(points, process=False).convex_hull
    for seed in range(10):
        shift = np.random.default_rng(seed).uniform(-50, 50, 3)
        source, centre = (tuple(np.add(place, shift).tolist()) for place in (HALVED.source_mm, HALVED.centre_mm))
        view, mesh = replace(HALVED, source_mm=source, centre_mm=centre), moved(blade, shift)
        exact = convex_chord(mesh, view)
        assert exact[:, 40].min() > 1.2e-3
        assert_allclose(trace(alone(mesh), view, engine=engine).path_mm["water"], exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, 4096), (4096, 1), (BAND_ROWS + 1, 7)])
def test_detectors_of_odd_shape_serve(engine, rows, cols):
    protocol = detector(rows=rows, cols=cols, pixel_mm=0.05)
    mesh = ball(40.0, subdivisions=2, at=(1.0, 2.0, 3.0))
    paths = trace(alone(mesh), protocol, engine=engine)
    assert paths.path_mm["water"].shape == (rows, cols)
    assert_allclose(paths.path_mm["water"], convex_chord(mesh, resolve_view(protocol)), rtol=0, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_surfaces_beside_the_detector_or_across_its_border_are_cut_off(engine):
    protocol = detector(rows=40, cols=50, pixel_mm=0.5)
    across, beside = ball(30.0, at=(12.0, 0.0, -9.0)), ball(10.0, at=(60.0, 0.0, 0.0))
    scene = Scene([Surface(across, "water", "air"), Surface(beside, "marrow", "air")])
    paths = trace(scene, protocol, engine=engine)
    assert_allclose(paths.path_mm["water"], convex_chord(across, resolve_view(protocol)), rtol=0, atol=1e-5)
    assert not paths.path_mm["marrow"].any()


@pytest.mark.parametrize("engine", ENGINES)
def test_the_bytes_do_not_depend_on_the_number_of_workers(engine):
    scene = Scene([Surface(rough(5, 30.0), "muscle", "air"), Surface(rough(6, 8.0), "marrow", "muscle")])
    one, two, five = (trace(scene, detector(300, 200, 0.5), engine=engine, workers=n) for n in (1, 2, 5))
    assert one.audit == two.audit == five.audit
    for name, path_mm in one.path_mm.items():
        assert path_mm.tobytes() == two.path_mm[name].tobytes() == five.path_mm[name].tobytes()


def test_a_mesh_with_a_cavity_wound_inwards_is_hollow():
    outer, cavity = ball(30.0), ball(20.0)
    cavity.invert()
    hollow = trimesh.util.concatenate([outer, cavity])
    expected = convex_chord(ball(30.0), resolve_view(detector())) - convex_chord(ball(20.0), resolve_view(detector()))
    for engine in ENGINES:
        paths = trace(alone(hollow), detector(), engine=engine)
        assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-5)


def test_only_the_materials_asked_for_come_back_in_that_order():
    scene = Scene([Surface(ball(30.0), "muscle", "air"), Surface(ball(20.0), "marrow", "muscle")])
    assert list(trace(scene, detector()).path_mm) == ["muscle", "marrow"]
    paths = trace(scene, detector(), materials=("marrow", "air"))
    assert list(paths.path_mm) == ["marrow", "air"]
    box_mm = box_length(scene.bounds_mm, resolve_view(detector()))
    assert_allclose(
        paths.path_mm["air"], box_mm - convex_chord(ball(30.0), resolve_view(detector())), rtol=0, atol=1e-4
    )


def test_the_audit_counts_the_pixels_in_the_box_of_a_surface_and_those_that_cross_it():
    view = resolve_view(detector())
    sheet = project_surface(alone(ball(30.0)).surfaces[0].solid, view)
    pixels = (sheet.rows[1] - sheet.rows[0]) * (sheet.cols[1] - sheet.cols[0])
    crossing = np.count_nonzero(trace(alone(ball(30.0)), view).path_mm["water"])
    for engine, rays in (("scanline", pixels), ("embree", crossing)):
        audit = trace(alone(ball(30.0)), view, engine=engine).audit
        assert audit.counts()["rays"] == audit.rays == rays
    assert list(audit.counts()) == ["rays", "unbalanced", "imprecise", "repaired", "unrepaired"]
    assert sum_audits([Audit(rays=2, repaired=1), Audit(rays=3)]) == Audit(rays=5, repaired=1)


def asked_of_embree(monkeypatch):
    """Counts of rays that Embree is asked for from now on, one for each call."""
    counts = []

    class Counting(embree.EmbreeScene):
        def run(self, origins, directions, **options):
            counts.append(len(origins))
            return super().run(origins, directions, **options)

    monkeypatch.setattr(embree, "EmbreeScene", Counting)
    return counts


def crossings(mesh, view, step=16):
    """Mean count of crossings over the rays that meet a mesh, of every so many rows and columns."""
    source, way = rays(view)
    way = way[::step, ::step].reshape(-1, 3)
    found = mesh.ray.intersects_location(np.broadcast_to(source, way.shape), way, multiple_hits=True)[1]
    return len(found) / len(np.unique(found))


@pytest.mark.parametrize("mesh", [ball(50.0, subdivisions=2), rough(3)], ids=["large triangles", "folds and slivers"])
def test_rays_that_share_what_a_neighbour_met_are_as_exact_as_those_that_are_cast(monkeypatch, mesh):
    fine = detector(rows=512, cols=512, pixel_mm=0.3)
    exact = trace(alone(mesh), fine, engine="scanline", precision="float64").path_mm["water"]
    crossed = crossings(mesh, resolve_view(fine))
    counts = asked_of_embree(monkeypatch)
    paths = trace(alone(mesh), fine, engine="embree", precision="float64")
    # Were each cast, a ray would be cast once for every crossing and once more.
    assert sum(counts) < 0.7 * crossed * paths.audit.rays
    assert_allclose(paths.path_mm["water"], exact, rtol=0, atol=1e-9)
    assert_clean(paths.audit)


def test_rays_of_small_triangles_take_those_across_the_edges_of_their_neighbours(monkeypatch):
    # Some three pixels each: hardly a ray lies inside the triangles of one cast five pixels away.
    mesh, fine = ball(50.0, subdivisions=6), detector(rows=512, cols=512, pixel_mm=0.3)
    exact = trace(alone(mesh), fine, engine="scanline", precision="float64").path_mm["water"]
    counts = asked_of_embree(monkeypatch)
    paths = trace(alone(mesh), fine, engine="embree", precision="float64")
    assert sum(counts) < 0.3 * paths.audit.rays
    assert_allclose(paths.path_mm["water"], exact, rtol=0, atol=1e-9)
    assert_clean(paths.audit)


@pytest.mark.parametrize("open_at", [None, 5])
def test_across_each_edge_is_the_face_that_has_it_the_other_way(open_at):
    faces = np.asarray(ball(1.0, subdivisions=2).faces, np.int32)
    faces = faces if open_at is None else np.delete(faces, open_at, axis=0)
    edges = {(face[k], face[(k + 1) % 3]): number for number, face in enumerate(faces.tolist()) for k in range(3)}
    wanted = [[edges.get((face[(k + 1) % 3], face[k]), -1) for k in range(3)] for face in faces.tolist()]
    across = find_adjacent_faces(faces, int(faces.max()) + 1)
    np.testing.assert_array_equal(across, wanted)
    assert np.count_nonzero(across < 0) == (0 if open_at is None else 3)


@pytest.mark.parametrize("count", [200, 3])
def test_parallel_plates_are_exact_and_what_is_in_doubt_in_a_band_is_repaired_at_once(monkeypatch, count):
    # The diagonals of their faces run through the centres of pixels.
    plates = [box(150.0, 0.2, 150.0, at=(0.0, 0.5 * k - 50.0, 0.0)) for k in range(count)]
    protocol = detector(rows=96, cols=96, pixel_mm=1.0)
    expected = sum(convex_chord(plate, resolve_view(protocol)) for plate in plates)
    calls, spans = [], scanline._find_spans
    monkeypatch.setattr(scanline, "_find_spans", lambda *given: calls.append(1) or spans(*given))
    scene = Scene([Surface(plate, "cortical_bone", "air") for plate in plates])
    paths = trace(scene, protocol, engine="embree", precision="float64")
    assert_allclose(paths.path_mm["cortical_bone"], expected, rtol=0, atol=1e-9)
    assert paths.audit.repaired > 50 * count
    assert_clean(paths.audit)
    # One look to count crossings and one for all that is in doubt.
    assert len(calls) <= 2 * count * (96 // BAND_ROWS)


def test_rays_that_are_given_up_are_repaired_to_the_same_numbers(monkeypatch):
    expected = trace(alone(rough(8)), detector()).path_mm["water"]
    monkeypatch.setattr(embree, "HIT_LIMIT", 1)
    paths = trace(alone(rough(8)), detector())
    assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-5)
    assert paths.audit.repaired == paths.audit.imprecise >= np.count_nonzero(expected)
    assert_clean(paths.audit)


def test_an_unbalanced_ray_is_counted_and_repaired(monkeypatch):
    class Forgetful(embree.EmbreeScene):
        """Embree that now and then loses a hit."""

        def run(self, origins, directions, **options):
            hit = super().run(origins, directions, **options)
            hit["primID"][np.arange(len(origins)) % 50 == 0] = -1
            return hit

    fine = detector(rows=384, cols=320, pixel_mm=0.425)  # a few percent of whose rays are cast
    expected = trace(alone(ball(30.0)), fine).path_mm["water"]
    monkeypatch.setattr(embree, "EmbreeScene", Forgetful)
    paths = trace(alone(ball(30.0)), fine)
    assert paths.audit.unbalanced > 10
    assert_clean(paths.audit)
    assert_allclose(paths.path_mm["water"], expected, rtol=0, atol=1e-5)


def test_signs_add_up_to_zero_on_every_row_of_a_scanned_surface():
    sheet = project_surface(alone(rough(9)).surfaces[0].solid, resolve_view(detector()))
    for row in range(*sheet.rows):
        assert not scanline.sum_windings(sheet, row, row + 1).any()


class Broken:
    """A density that gives no number."""

    def integrate(self, starts_mm, ends_mm):
        return np.full(len(starts_mm), np.nan)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_density_that_gives_no_number_is_refused_with_its_surfaces(engine):
    broken = Broken()
    shell = Surface(ball(30.0), "water", "air", "shell", inside_density=broken)
    core = Surface(ball(20.0), "muscle", "water", "core", outside_density=broken)
    gave_nan = r"^shell(, core)?: density of water: Broken.integrate must return .*, got nan for \d+ segments"
    with pytest.raises(InputError, match=gave_nan):
        trace(Scene([shell, core]), detector(), engine=engine)
    assert trace(Scene([shell, core]), detector(), engine=engine, texture=False).path_mm["water"].max() > 10


def test_paths_know_their_scene_and_are_compared_and_printed_without_their_arrays():
    scene = alone(ball(30.0))
    paths, again = (trace(scene, detector()) for _ in range(2))
    assert paths.scene is scene
    assert paths == again
    assert hash(paths) == hash(again)
    assert paths != trace(alone(ball(30.0)), detector())
    assert paths != trace(scene, detector(rows=95))
    assert paths != trace(scene, detector(), materials=["air", "water"])
    other = replace(paths, path_mm={"water": paths.path_mm["water"] + 1})
    assert paths != other
    assert paths != "paths"
    assert repr(paths).startswith("Paths(water: (96, 80) mm, Audit(rays=")
    assert "array" not in repr(paths)


def test_a_scene_of_a_thousand_surfaces_and_more_is_cast_by_embree():
    mesh = trimesh.creation.icosahedron()
    mesh.apply_scale(30.0)
    surfaces = [Surface(mesh, "water", "water", f"number {k}") for k in range(1500)]
    scene = Scene([Surface(mesh, "water", "air"), *surfaces])
    paths = trace(scene, detector(rows=2, cols=2, pixel_mm=3.0))
    assert_allclose(paths.path_mm["water"], convex_chord(mesh, resolve_view(detector(2, 2, 3.0))), rtol=0, atol=1e-5)


def test_unknown_engines_materials_and_workers_are_refused():
    scene = alone(ball(10.0))
    for materials in ("water", 3):
        with pytest.raises(InputError, match=f"materials must be a list of air, water, got {materials!r}"):
            trace(scene, detector(), materials=materials)
    with pytest.raises(InputError, match=r"material must be one of air, water, got \['water'\]"):
        trace(scene, detector(), materials=[["water"]])
    with pytest.raises(InputError, match="texture must be one of True, False, got 'none'"):
        trace(scene, detector(), texture="none")
    with pytest.raises(InputError, match=r"engine must be one of .*, got 'embre' \(did you mean 'embree'\?\)"):
        trace(scene, detector(), engine="embre")
    with pytest.raises(InputError, match="material must be one of air, water, got 'watre'"):
        trace(scene, detector(), materials=["watre"])
    with pytest.raises(InputError, match="precision must be one of float32, float64, got 'double'"):
        trace(scene, detector(), precision="double")
    with pytest.raises(InputError, match=r"workers must be .*, got 0"):
        trace(scene, detector(), workers=0)
