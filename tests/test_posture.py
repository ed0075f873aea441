"""Check flexed knees and PA views: posture preserves anatomy, and labels agree with the projection."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy import built_knee
from pssf.anatomy.meshing.solids import extract_mesh
from pssf.anatomy.posture.flexion import flex_pose
from pssf.core.checks import InputError
from pssf.geometry.mesh import Mesh

REFERENCE = pssf.load_protocol("reference")
FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
SMALL = dict(rows=256, cols=256, pixel_mm=1.2)
READ = pssf.Knee(jsw_medial_mm=4.2, jsw_lateral_mm=5.1, jsw_definition="read", flexion_deg=3.0, rotation_deg=2.0)

# Knee with an osteophyte, whose bones take a second to grow.
GROWN_KNEE = pssf.Knee(
    jsw_medial_mm=3.0, side="left", osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=2.0),), fabella_mm=8.0
)


@pytest.fixture(scope="module")
def flexed():
    return pssf.build(READ, FIXED_FLEXION)


def test_a_pa_view_mirrors_the_knee_along_the_beam(knee, scene):
    behind = pssf.build(knee, dataclasses.replace(REFERENCE, projection="PA")).scene
    for front, back in zip(scene.surfaces, behind.surfaces, strict=True):
        assert front.name == back.name
        assert_allclose(back.mesh_arrays.vertices, front.mesh_arrays.vertices * [1, -1, 1], atol=1e-9)
        volumes = [surface.mesh_arrays.as_trimesh().volume for surface in (front, back)]
        assert volumes[0] == pytest.approx(volumes[1], rel=1e-9)
        assert volumes[1] > 0


def test_trabeculae_are_mirrored_with_the_knee_in_a_pa_view(knee, scene):
    behind = pssf.build(knee, dataclasses.replace(REFERENCE, projection="PA")).scene
    front, back = (
        next(s for s in one.surfaces if s.name == "tibia_trabecular").inside_density for one in (scene, behind)
    )
    rng = np.random.default_rng(4)
    starts, ends = rng.uniform([-25, -15, -40], [25, 15, -10], (2, 50, 3))
    mirror = np.array([1, -1, 1])
    assert_allclose(back.integrate(starts * mirror, ends * mirror), front.integrate(starts, ends), rtol=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_measured_radiographic_jsw_equals_the_specified_jsw(side):
    knee = dataclasses.replace(READ, side=side)
    assert_allclose(pssf.build(knee, FIXED_FLEXION).measure_jsw_mm(FIXED_FLEXION), [4.2, 5.1], atol=1e-3)


def test_jsw_converges_if_the_plateau_floor_alternates():
    """Check a sampled knee whose joint line alternated by 0.07 mm in height and 0.28 mm in JSW between iterations."""
    shape = (-1.1221, 1.0708, 0.5, 0.4836, 0.2127, 0.71, 0.313, -0.0709, 0.1872, 1.2917, -1.0504, 0.1207, -1.9536)
    knee = pssf.Knee(
        sex="female", stature_mm=1585.822, bone_scale=1.0457, shape=shape, jsw_definition="read", jsw_medial_mm=4.1388,
        jsw_lateral_mm=4.7705, subchondral_plate=1.2447, cortex_scale=1.0437, varus_deg=-1.1264, flexion_deg=0.1007,
        rotation_deg=-0.81, tibial_slope_deg=4.779, lean_deg=4.1602,
        osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=0.8988, curve_deg=10.0),),
    )  # fmt: skip
    assert_allclose(pssf.build(knee, FIXED_FLEXION).measure_jsw_mm(FIXED_FLEXION), [4.1388, 4.7705], atol=1e-3)


def test_flexion_preserves_the_gap_below_each_condyle(flexed):
    """Measure gaps below each condyle with rays along the tibial axis, which the library trimesh casts."""
    straight = pssf.build(READ)
    gaps = [np.array(list(_find_least_gaps(one))) for one in (straight, flexed)]
    assert_allclose(gaps[1], gaps[0], atol=0.15)
    rotation_deg = np.rad2deg(
        np.arccos((np.trace(_compute_relative_rotation(straight).T @ _compute_relative_rotation(flexed)) - 1) / 2)
    )
    assert rotation_deg == pytest.approx(FIXED_FLEXION.flexion_deg, abs=1.0)


def _compute_relative_rotation(built):
    pose = built.assembly.pose
    return pose.tibia_transform()[:, :3].T @ pose.femur_transform()[:, :3]


def _find_least_gaps(built):
    assembly = built.assembly
    pose = assembly.pose
    to_tibia = np.linalg.inv(np.vstack((pose.tibia_transform(), [0, 0, 0, 1])))
    femur, tibia = (built.bones[name].outer for name in ("femur", "tibia"))
    femur, tibia = (extract_mesh(solid.transform(to_tibia[:3])).as_trimesh() for solid in (femur, tibia))
    half = assembly.bone_parameters.half_ml_mm
    for side in (+1, -1):
        x, y = np.meshgrid(side * np.linspace(0.4, 0.8, 25) * half, np.linspace(-18, 18, 37))
        feet = np.column_stack((x.ravel(), y.ravel(), np.full(x.size, 200.0)))
        down = np.tile([0.0, 0.0, -1.0], (len(feet), 1))
        plateau = _find_first_heights(tibia, feet, down)
        condyle = _find_first_heights(femur, feet * [1, 1, -1], -down)
        yield np.nanmin(condyle - plateau)


def _find_first_heights(mesh, starts, directions):
    """Find the height of the first intersection of each ray; nan for rays without intersection."""
    points, rays, _ = mesh.ray.intersects_location(starts, directions, multiple_hits=True)
    height = np.full(len(starts), np.nan)
    for ray, z in zip(rays, points[:, 2], strict=True):
        best = height[ray]
        if np.isnan(best) or z * directions[ray, 2] < best * directions[ray, 2]:
            height[ray] = z
    return height


def test_extension_followed_by_equal_flexion_restores_the_pose(flexed):
    pose = flexed.assembly.pose
    femur, tibia = (extract_mesh(flexed.bones[name].outer) for name in ("femur", "tibia"))

    def convert_to_local(mesh: Mesh, frame):
        return (mesh.vertices - frame[:, 3]) @ frame[:, :3]

    bones = convert_to_local(femur, pose.femur_transform()), convert_to_local(tibia, pose.tibia_transform())
    half = flexed.assembly.bone_parameters.half_ml_mm
    back = flex_pose(flex_pose(pose, *bones, half, -15.0), *bones, half, 15.0)
    assert_allclose(back.femur_to_tibia_transform(), pose.femur_to_tibia_transform(), atol=0.01)


def test_most_femoral_external_rotation_occurs_in_the_first_30_degrees(flexed):
    def compute_external_rotation_deg(flexion_deg):
        across = dataclasses.replace(flexed.assembly.pose, flexion_deg=flexion_deg).femur_to_tibia_transform()[:, 0]
        # The medial side moves forwards and the lateral side backwards.
        return -np.rad2deg(np.arctan2(across[1], across[0]))

    assert compute_external_rotation_deg(0.0) == pytest.approx(0.0, abs=1e-9)
    assert 4.5 < compute_external_rotation_deg(22.0) < 10.0
    assert compute_external_rotation_deg(60.0) - compute_external_rotation_deg(30.0) < 0.5 * (
        compute_external_rotation_deg(30.0) - compute_external_rotation_deg(0.0)
    )


def test_labels_of_flexed_left_and_right_knees_are_mirror_images(flexed):
    left = pssf.build(dataclasses.replace(READ, side="left"), FIXED_FLEXION)
    right_px, left_px = flexed.truth(FIXED_FLEXION).landmarks_px, left.truth(FIXED_FLEXION).landmarks_px
    for name, (row, col) in right_px.items():
        assert_allclose(left_px[name], (row, FIXED_FLEXION.cols - 1 - col), atol=1e-6)


def test_contours_of_a_flexed_knee_agree_with_its_masks(flexed):
    protocol = dataclasses.replace(FIXED_FLEXION, rows=512, cols=512, pixel_mm=0.6)
    truth = pssf.simulate(flexed, protocol, keep=("masks",)).truth
    row, col = truth.landmarks_px["medial_spine"]
    assert np.flatnonzero(truth.masks["tibia"][:, round(col)])[0] == pytest.approx(row, abs=1.5)
    # The plateau rims determine the contour, so the plateau floor is below the contour.
    row, col = truth.landmarks_px["tibia_medial_1"]
    assert np.flatnonzero(truth.masks["tibia"][:, round(col)])[0] < row + 0.5


def test_both_engines_find_no_negative_paths_in_a_flexed_knee(flexed):
    protocol = dataclasses.replace(FIXED_FLEXION, **SMALL)
    one, other = (
        pssf.trace(flexed.scene, protocol, engine=engine, precision="float64") for engine in ("embree", "scanline")
    )
    for material, path_mm in one.path_mm.items():
        assert path_mm.min() > -1e-6
        assert_allclose(path_mm, other.path_mm[material], atol=1e-6)


def test_a_knee_built_in_another_posture_raises_an_error(built):
    with pytest.raises(
        InputError,
        match=r"knee must be built in the protocol posture, Posture\(projection='PA'.*got Posture\(projection='AP'",
    ):
        pssf.simulate(built, FIXED_FLEXION)


def test_building_with_an_invalid_protocol_raises_an_error():
    with pytest.raises(InputError, match="protocol must be a Protocol or None, got 'fixed_flexion'"):
        pssf.build(pssf.Knee(), "fixed_flexion")


@pytest.mark.parametrize("flexion_deg", [10.0, 40.0])
@pytest.mark.parametrize("seed", range(2))
def test_sampled_knees_can_be_flexed(flexion_deg, seed):
    knee = pssf.sample_knee(grade=2, rng=np.random.default_rng(seed), grade_table="paper")
    protocol = dataclasses.replace(FIXED_FLEXION, flexion_deg=flexion_deg, **SMALL)
    assert pssf.build(knee, protocol).scene.surfaces


def test_another_posture_keeps_the_bones_and_gives_identical_surfaces(monkeypatch):
    lateral = pssf.load_protocol("lateral")
    pssf.build(GROWN_KNEE)
    with monkeypatch.context() as patch:
        patch.setattr(built_knee, "grow_bones", lambda *_: pytest.fail("grown again"))
        patch.setattr(built_knee, "build_bones", lambda *_: pytest.fail("built again"))
        again = pssf.build(GROWN_KNEE, lateral)
    # Another thread keeps no bones.
    with ThreadPoolExecutor(1) as pool:
        anew = pool.submit(pssf.build, GROWN_KNEE, lateral).result()
    for one, other in zip(again.scene.surfaces, anew.scene.surfaces, strict=True):
        assert one.name == other.name
        assert np.array_equal(one.mesh_arrays.vertices, other.mesh_arrays.vertices), one.name
        assert np.array_equal(one.mesh_arrays.faces, other.mesh_arrays.faces), one.name


def test_a_knee_with_other_parameters_shares_no_bones_with_the_last_one():
    narrow = dataclasses.replace(GROWN_KNEE, jsw_medial_mm=GROWN_KNEE.jsw_medial_mm - 1.0)
    labels = [
        pssf.build(knee).truth(pssf.load_protocol("reference")).jsw_medial_mm
        for knee in (GROWN_KNEE, narrow, GROWN_KNEE)
    ]
    assert labels == pytest.approx([3.0, 2.0, 3.0], abs=1e-3)
