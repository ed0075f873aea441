"""Check the comparison of bones: registration, surface distances, mean bones and shape measures."""

import dataclasses

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import pssf
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.geometry.mesh import Mesh
from pssf.io.meshes.bone_folder import read_bones
from pssf.model.sampling.knee_sampling import load_knee_distributions
from pssf.patient_comparison.bones import bone_comparison, bone_registration
from pssf.patient_comparison.bones.surface_distance import (
    SimilarityTransform,
    fit_similarity,
    measure_surface_distance,
    sample_surface,
    trim_to_heights,
)


def make_pebble(bump_mm=0.0, detail=4):
    """Make an asymmetric closed body about 50 mm long, with a bump on one side."""
    sphere = trimesh.creation.icosphere(detail)
    x, y, z = sphere.vertices.T
    radius = 20 + 4 * x * y + 3 * z**3 + 2.5 * x**2 - 2 * np.sin(3 * y) + bump_mm * np.exp(-4 * ((x - 1) ** 2 + z**2))
    return Mesh(sphere.vertices * radius[:, None] * [1.2, 0.8, 1.0], np.asarray(sphere.faces))


def move_mesh(mesh, degrees=0.0, scale=1.0, shift=(0.0, 0.0, 0.0)):
    rotation = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, -0.48, 0.64])).as_matrix()
    return Mesh(
        SimilarityTransform(rotation=rotation, scale=scale, translation_mm=np.array(shift)).apply(mesh.vertices),
        mesh.faces,
    )


def make_ball(radius_mm):
    mesh = trimesh.creation.icosphere(5, radius=radius_mm)
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def make_shaft(top_mm):
    """Make a bone whose joint end is a pebble and whose shaft is cut horizontally at a height."""
    mesh = trimesh.creation.cylinder(9.0, segment=([0, 0, 0], [0, 0, top_mm]), sections=48)
    both = trimesh.boolean.union([make_pebble().as_trimesh(), mesh], engine="manifold")
    return Mesh(np.asarray(both.vertices), np.asarray(both.faces))


def test_a_rotated_scaled_and_shifted_copy_is_at_distance_zero():
    copy = sample_surface(move_mesh(make_pebble(), 7.0, 1.25, (6.0, -4.0, 3.0)), seed=1)
    fit = fit_similarity(copy, sample_surface(make_pebble()))
    assert_allclose(fit.scale, 1 / 1.25, rtol=1e-4)
    distance = measure_surface_distance(copy, sample_surface(make_pebble()), fit)
    assert distance.rms_mm < 0.003
    assert measure_surface_distance(copy, sample_surface(make_pebble())).rms_mm > 3.0


def test_a_similarity_transform_and_its_inverse_cancel():
    fit = fit_similarity(sample_surface(move_mesh(make_pebble(), 5.0, 1.1)), sample_surface(make_pebble()))
    assert_allclose(fit.apply_inverse(fit.apply(make_pebble().vertices)), make_pebble().vertices, atol=1e-9)
    assert_allclose(fit.rotation @ fit.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(fit.rotation) > 0


def test_signed_distance_of_two_spheres_is_the_difference_of_radii():
    outer = measure_surface_distance(sample_surface(make_ball(21.5)), sample_surface(make_ball(20.0)))
    for found in (outer.mean_mm, outer.rms_mm, outer.p99_mm):
        assert_allclose(found, 1.5, atol=0.02)
    inner = measure_surface_distance(sample_surface(make_ball(20.0)), sample_surface(make_ball(21.5)))
    assert_allclose(inner.mean_mm, -1.5, atol=0.02)
    assert (inner.backward_mm < 0).all()


def test_the_fit_removes_differences_of_size():
    big, small = sample_surface(make_ball(21.5)), sample_surface(make_ball(20.0))
    fit = fit_similarity(big, small)
    assert_allclose(fit.scale, 20 / 21.5, rtol=1e-3)
    assert measure_surface_distance(big, small, fit).rms_mm < 0.02


def test_the_nearest_point_is_the_nearest_on_all_triangles():
    # Triangles of unequal size: the triangle with the nearest centroid is not always the nearest triangle.
    surface = sample_surface(make_shaft(60.0))
    points = np.random.default_rng(0).normal([0.0, 0.0, 20.0], 25.0, size=(300, 3))
    found, _ = surface.find_nearest(points)
    corners = surface.mesh.vertices[surface.mesh.faces]
    least = []
    for point in points:
        every = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        least.append(np.linalg.norm(every - point, axis=1).min())
    more = np.linalg.norm(found - points, axis=1) - least
    assert (more > -1e-9).all()
    # The search considers eight centroids; near slivers, the nearest triangle may not be among these eight.
    assert more.max() < 0.02
    assert (more < 1e-6).mean() > 0.95


def test_a_shaft_cut_at_another_height_has_distance_zero_in_the_overlap():
    long, short = sample_surface(make_shaft(95.0)), sample_surface(make_shaft(70.0))
    heights = bone_registration.compared_heights_mm(short.mesh, "femur")
    assert_allclose(heights[1], 65.0)
    assert measure_surface_distance(long, short, heights_mm=heights).rms_mm < 0.02
    assert measure_surface_distance(long, short).rms_mm > 3.0
    assert bone_registration.compared_heights_mm(move_mesh(short.mesh, 0.0, -1.0), "tibia")[0] == pytest.approx(-65.0)
    assert bone_registration.compared_heights_mm(short.mesh, "patella") == (-np.inf, np.inf)


def test_a_mesh_is_trimmed_at_two_heights_within_its_extent():
    part = trim_to_heights(make_shaft(95.0), -5.0, 60.0)
    used = part.vertices[np.unique(part.faces)]
    assert_allclose((used[:, 2].min(), used[:, 2].max()), (-5.0, 60.0), atol=1e-9)
    with pytest.raises(pssf.InputError, match="faces between 200 and inf mm, got 0"):
        trim_to_heights(make_shaft(95.0), 200.0, np.inf)
    with pytest.raises(pssf.InputError, match="got 0 and 0 points at 30 to 40 mm"):
        fit_similarity(sample_surface(make_ball(20.0)), sample_surface(make_ball(20.0)), heights_mm=(30.0, 40.0))
    with pytest.raises(pssf.InputError, match="got 0 mm2"):
        sample_surface(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))


@pytest.mark.parametrize("other_faces", [False, True])
def test_the_mean_bone_has_the_mean_shape_and_size(other_faces):
    meshes = [move_mesh(make_pebble(bump), 3 * bump, scale, (bump, 0, 1)) for bump, scale in ((-2.0, 0.9), (2.0, 1.1))]
    if other_faces:
        refined = trimesh.remesh.subdivide(*meshes[1])
        meshes[1] = Mesh(np.asarray(refined[0]), np.asarray(refined[1]))
    mean = sample_surface(bone_comparison.compute_mean_bone(meshes, "patella"))
    fit = fit_similarity(sample_surface(make_pebble()), mean)
    assert_allclose(fit.scale, np.sqrt(0.9 * 1.1), rtol=0.01)
    assert measure_surface_distance(sample_surface(make_pebble()), mean, fit).rms_mm < 0.06
    fit_to_first = fit_similarity(sample_surface(meshes[0]), mean)
    assert measure_surface_distance(sample_surface(meshes[0]), mean, fit_to_first).rms_mm > 0.2


def test_the_mean_of_no_bones_raises_an_error():
    with pytest.raises(pssf.InputError, match="number of patella meshes must be 1 or more, got 0"):
        bone_comparison.compute_mean_bone([], "patella")


def make_varied_pebbles(amplitude_mm, seed):
    """Make pebbles of several sizes and positions, with different bumps whose mean height is 0."""
    rng = np.random.default_rng(seed)
    sizes = amplitude_mm * np.array([-1.5, -0.5, 0.5, 1.5])
    return [
        move_mesh(make_pebble(bump), rng.normal(scale=3), rng.uniform(0.85, 1.15), rng.normal(size=3)) for bump in sizes
    ]


@pytest.fixture(scope="module")
def comparison():
    patients, sampled = make_varied_pebbles(3.0, 1), make_varied_pebbles(1.0, 2)
    return bone_comparison.compare_bones(
        {"patella": patients}, {"patella": move_mesh(make_pebble(), 4.0, 0.8)}, {"patella": sampled}
    )


def test_spreads_of_patient_and_sampled_bones_use_the_same_measure(comparison):
    mean, patients, sampled = comparison.rows
    assert [row["comparison"] for row in comparison.rows] == [
        "built mean to patient mean", "patient bones to their mean", "sampled bones to built mean",
    ]  # fmt: skip
    assert mean["rms_mm"] < 0.05
    assert patients["bones"] == sampled["bones"] == 4
    assert_allclose(patients["rms_mm"] / sampled["rms_mm"], 3.0, rtol=0.1)
    assert patients["rms_min_mm"] < patients["rms_mm"] < patients["rms_max_mm"] < patients["p99_mm"]
    assert 0.03 < sampled["scale_sd"] < 0.3


def test_a_bump_on_the_mean_built_bone_is_located():
    given = [make_pebble()]
    found = bone_comparison.compare_bones({"patella": given}, {"patella": make_pebble(4.0)}, {"patella": given})
    assert len(found.rows) == 1
    fit = found.fits["patella"]
    point = fit.placed_mesh.vertices[fit.off_mm.argmax()]
    assert 1.5 < fit.off_mm.max() < 4.0
    assert point[0] > 20
    assert abs(point[2]) < 6
    assert_allclose(found.rows[0]["p99_mm"], np.percentile(np.abs(fit.off_mm), 99), atol=0.5)


def test_the_same_bones_give_the_same_rows_and_figure(comparison):
    patients, sampled = make_varied_pebbles(3.0, 1), make_varied_pebbles(1.0, 2)
    again = bone_comparison.compare_bones(
        {"patella": patients}, {"patella": move_mesh(make_pebble(), 4.0, 0.8)}, {"patella": sampled}
    )
    assert again.rows == comparison.rows
    assert again.figure == comparison.figure
    assert again.figure.startswith(b"\x89PNG")


def test_unknown_bone_names_raise_an_error():
    with pytest.raises(pssf.InputError, match="bones must include one or more of femur, tibia, patella, got ulna"):
        bone_comparison.compare_bones({"ulna": [make_pebble()]}, {}, {})


def test_built_bones_are_closed_and_vary_with_the_sampled_shape():
    sampled = bone_comparison.sample_bones(load_knee_distributions("population"), load_anatomy_tables(), 2, seed=4)
    for name, mesh in bone_comparison.build_bones(pssf.Knee(), load_anatomy_tables()).items():
        assert mesh.as_trimesh().is_watertight
        assert len(sampled[name]) == 2
        assert abs(np.ptp(sampled[name][0].vertices[:, 0]) - np.ptp(sampled[name][1].vertices[:, 0])) > 0.01
    for name, mesh in bone_comparison.sample_bones(
        load_knee_distributions("population"), load_anatomy_tables(), 3, seed=4
    ).items():
        assert_array_equal(mesh[1].vertices, sampled[name][1].vertices)
    tilted = bone_comparison.build_bones(dataclasses.replace(pssf.Knee(), tibial_slope_deg=9.0), load_anatomy_tables())[
        "tibia"
    ]
    plain = bone_comparison.build_bones(pssf.Knee(), load_anatomy_tables())["tibia"]
    near = [sample_surface(bone_registration.crop_near_joint(mesh, "tibia")) for mesh in (tilted, plain)]
    heights = bone_registration.compared_heights_mm(near[1].mesh, "tibia")
    assert 0.2 < measure_surface_distance(*near, fit_similarity(*near, heights_mm=heights), heights).rms_mm < 1.5


def write_archive(folder, **arrays):
    mesh = make_pebble(detail=2)
    content = {
        "femur_mm": np.stack([mesh.vertices] * 2).astype(np.float32),
        "femur_faces": mesh.faces.astype(np.uint16),
    }
    np.savez(folder / "knees.npz", **{name: value for name, value in (content | arrays).items() if value is not None})
    return folder


def test_corresponding_bones_are_read_from_an_archive(tmp_path):
    for path in (write_archive(tmp_path), tmp_path / "knees.npz"):
        found = read_bones(path)
        assert list(found) == ["femur"]
        assert len(found["femur"]) == 2
        assert_allclose(found["femur"][1].vertices, make_pebble(detail=2).vertices, atol=1e-5)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_bones_are_read_from_one_folder_of_meshes_per_bone(tmp_path, suffix):
    for kind, scale in (("tibia", 1.0), ("patella", 0.5)):
        (tmp_path / kind).mkdir()
        move_mesh(make_pebble(detail=2), 0.0, scale).as_trimesh().export(tmp_path / kind / f"one.{suffix}")
    (tmp_path / "tibia" / "notes.txt").write_text("not a mesh")
    found = read_bones(tmp_path)
    assert set(found) == {"tibia", "patella"}
    assert_allclose(
        np.ptp(found["patella"][0].vertices, axis=0), np.ptp(make_pebble(detail=2).vertices, axis=0) / 2, rtol=1e-4
    )


@pytest.mark.parametrize(
    ("arrays", "why"),
    [
        ({"femur_mm": np.zeros((4, 3))}, r"femur_mm must be \(bones, vertices, 3\) floats, got \(4, 3\), float64"),
        ({"femur_mm": np.full((1, 200, 3), np.nan)}, "femur_mm must be finite, got 600 non-finite values"),
        ({"femur_faces": None}, "must contain femur_mm and femur_faces, got only femur_mm"),
        ({"femur_faces": np.array([[0, 1, 999]])}, "femur_faces must be vertex indices from 0 to 161, got 0 to 999"),
        ({"femur_faces": np.zeros((1, 3))}, r"femur_faces must be \(faces, 3\) integers, got \(1, 3\), float64"),
        ({"femur_mm": None}, "got no bones"),
    ],
)
def test_invalid_arrays_of_bones_raise_an_error(tmp_path, arrays, why):
    with pytest.raises(pssf.InputError, match=why):
        read_bones(write_archive(tmp_path, **arrays))


def test_a_folder_without_bones_and_damaged_files_raise_an_error(tmp_path):
    with pytest.raises(pssf.InputError, match="got no bones"):
        read_bones(tmp_path)
    with pytest.raises(pssf.InputError, match="No such file"):
        read_bones(tmp_path / "none.npz")
    (tmp_path / "femur").mkdir()
    (tmp_path / "femur" / "a.stl").write_bytes(b"nothing")
    with pytest.raises(pssf.InputError, match=r"a\.stl"):
        read_bones(tmp_path)
    (tmp_path / "a.npz").write_bytes(b"nothing")
    with pytest.raises(pssf.InputError, match="no arrays"):
        read_bones(tmp_path)
    write_archive(tmp_path)
    with pytest.raises(pssf.InputError, match="got 2 npz files"):
        read_bones(tmp_path)


@pytest.mark.slow  # All bones are built six times.
def test_bone_measures_detect_a_stretched_bone():
    built = bone_comparison.build_bones(pssf.Knee(), load_anatomy_tables())
    pair = [bone_comparison.build_bones(pssf.Knee(shape=(score,)), load_anatomy_tables()) for score in (-1.0, 1.0)]
    sampled = {name: [one[name] for one in pair] for name in bone_comparison.BONES}
    for row in bone_comparison.compare_bones(sampled, built, sampled).measure_rows:
        assert abs(row["difference_sd"]) < 1e-9 or row["patient_sd"] < 1e-9
    high = {**sampled, "patella": [Mesh(one.vertices * [1.0, 1.0, 1.2], one.faces) for one in sampled["patella"]]}
    row = next(
        r
        for r in bone_comparison.compare_bones(sampled, built, high).measure_rows
        if r["measure"] == "patella's height over width"
    )
    assert row["simulated_mean"] / row["patient_mean"] == pytest.approx(1.2, rel=0.02)
