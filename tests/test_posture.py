"""Knees bent and seen from behind: the same knee, its labels where the film shows them."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy.meshing.solids import extract_mesh
from pssf.anatomy.posture.flexion import flex_pose
from pssf.core.checks import InputError
from pssf.geometry.mesh import Mesh

REFERENCE = pssf.load_protocol("reference")
FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
SMALL = dict(rows=256, cols=256, pixel_mm=1.2)
READ = pssf.Knee(jsw_medial_mm=4.2, jsw_lateral_mm=5.1, jsw_definition="read", flexion_deg=3.0, rotation_deg=2.0)


@pytest.fixture(scope="module")
def bent():
    return pssf.build(READ, FIXED_FLEXION)


def test_a_knee_seen_from_behind_is_mirrored_in_the_way_of_the_beam(knee, scene):
    behind = pssf.build(knee, dataclasses.replace(REFERENCE, projection="PA")).scene
    for front, back in zip(scene.surfaces, behind.surfaces, strict=True):
        assert front.name == back.name
        assert_allclose(back.mesh_arrays.vertices, front.mesh_arrays.vertices * [1, -1, 1], atol=1e-9)
        volumes = [surface.mesh_arrays.as_trimesh().volume for surface in (front, back)]
        assert volumes[0] == pytest.approx(volumes[1], rel=1e-9)
        assert volumes[1] > 0


def test_trabeculae_go_with_a_knee_seen_from_behind(knee, scene):
    behind = pssf.build(knee, dataclasses.replace(REFERENCE, projection="PA")).scene
    here, there = (
        next(s for s in one.surfaces if s.name == "tibia_trabecular").inside_density for one in (scene, behind)
    )
    rng = np.random.default_rng(4)
    starts, ends = rng.uniform([-25, -15, -40], [25, 15, -10], (2, 50, 3))
    mirror = np.array([1, -1, 1])
    assert_allclose(there.integrate(starts * mirror, ends * mirror), here.integrate(starts, ends), rtol=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_joint_space_as_readers_take_it_is_the_one_asked_for(side):
    knee = dataclasses.replace(READ, side=side)
    assert_allclose(pssf.build(knee, FIXED_FLEXION).measure_jsw_mm(FIXED_FLEXION), [4.2, 5.1], atol=1e-3)


def test_spaces_are_met_where_the_floor_of_the_plateau_jumps_as_the_tibia_moves():
    """A drawn knee that has 0.07 mm of height against 0.28 mm of space: its joint line never came to rest."""
    shape = (-1.1221, 1.0708, 0.5, 0.4836, 0.2127, 0.71, 0.313, -0.0709, 0.1872, 1.2917, -1.0504, 0.1207, -1.9536)
    knee = pssf.Knee(
        sex="female", stature_mm=1585.822, bone_scale=1.0457, shape=shape, jsw_definition="read", jsw_medial_mm=4.1388,
        jsw_lateral_mm=4.7705, subchondral_plate=1.2447, cortex_scale=1.0437, varus_deg=-1.1264, flexion_deg=0.1007,
        rotation_deg=-0.81, tibial_slope_deg=4.779, lean_deg=4.1602,
        osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=0.8988, curve_deg=10.0),),
    )  # fmt: skip
    assert_allclose(pssf.build(knee, FIXED_FLEXION).measure_jsw_mm(FIXED_FLEXION), [4.1388, 4.7705], atol=1e-3)


def test_a_bent_knee_keeps_its_height_above_the_plateau(bent):
    """Rays along the tibia's axis, cast by another library, from a grid below either condyle."""
    straight = pssf.build(READ)
    gaps = [np.array(list(_least_gaps(one))) for one in (straight, bent)]
    assert_allclose(gaps[1], gaps[0], atol=0.15)
    turned = np.rad2deg(np.arccos((np.trace(_relative(straight).T @ _relative(bent)) - 1) / 2))
    assert turned == pytest.approx(FIXED_FLEXION.flexion_deg, abs=1.0)


def _relative(built):
    pose = built.assembly.pose
    return pose.tibia_transform()[:, :3].T @ pose.femur_transform()[:, :3]


def _least_gaps(built):
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
        plateau = _first(tibia, feet, down)
        condyle = _first(femur, feet * [1, 1, -1], -down)
        yield np.nanmin(condyle - plateau)


def _first(mesh, starts, ways):
    """Height of the first place that each ray meets; nan where it meets none."""
    places, rays, _ = mesh.ray.intersects_location(starts, ways, multiple_hits=True)
    height = np.full(len(starts), np.nan)
    for ray, z in zip(rays, places[:, 2], strict=True):
        best = height[ray]
        if np.isnan(best) or z * ways[ray, 2] < best * ways[ray, 2]:
            height[ray] = z
    return height


def test_bending_there_and_back_is_no_change(bent):
    pose = bent.assembly.pose
    femur, tibia = (extract_mesh(bent.bones[name].outer) for name in ("femur", "tibia"))

    def own(mesh: Mesh, frame):
        return (mesh.vertices - frame[:, 3]) @ frame[:, :3]

    bones = own(femur, pose.femur_transform()), own(tibia, pose.tibia_transform())
    half = bent.assembly.bone_parameters.half_ml_mm
    back = flex_pose(flex_pose(pose, *bones, half, -15.0), *bones, half, 15.0)
    assert_allclose(back.femur_to_tibia_transform(), pose.femur_to_tibia_transform(), atol=0.01)


def test_a_bent_femur_turns_outwards_on_the_tibia_most_of_it_in_the_first_thirty_degrees(bent):
    def out_deg(flexion_deg):
        across = dataclasses.replace(bent.assembly.pose, flexion_deg=flexion_deg).femur_to_tibia_transform()[:, 0]
        return -np.rad2deg(np.arctan2(across[1], across[0]))  # to medial goes forwards, so to lateral backwards

    assert out_deg(0.0) == pytest.approx(0.0, abs=1e-9)
    assert 4.5 < out_deg(22.0) < 10.0
    assert out_deg(60.0) - out_deg(30.0) < 0.5 * (out_deg(30.0) - out_deg(0.0))


def test_labels_of_a_left_knee_mirror_those_of_a_right_one_when_bent(bent):
    left = pssf.build(dataclasses.replace(READ, side="left"), FIXED_FLEXION)
    here, there = bent.truth(FIXED_FLEXION).landmarks_px, left.truth(FIXED_FLEXION).landmarks_px
    for name, (row, col) in here.items():
        assert_allclose(there[name], (row, FIXED_FLEXION.cols - 1 - col), atol=1e-6)


def test_the_contours_of_a_bent_knee_are_where_its_masks_end(bent):
    protocol = dataclasses.replace(FIXED_FLEXION, rows=512, cols=512, pixel_mm=0.6)
    truth = pssf.simulate(bent, protocol, keep=("masks",)).truth
    row, col = truth.landmarks_px["medial_spine"]
    assert np.flatnonzero(truth.masks["tibia"][:, round(col)])[0] == pytest.approx(row, abs=1.5)
    # The floor lies under the contour, which the plateau's rims stand up to.
    row, col = truth.landmarks_px["tibia_medial_1"]
    assert np.flatnonzero(truth.masks["tibia"][:, round(col)])[0] < row + 0.5


def test_a_bent_knee_has_no_path_of_less_than_nothing_and_both_engines_agree(bent):
    protocol = dataclasses.replace(FIXED_FLEXION, **SMALL)
    one, other = (
        pssf.trace(bent.scene, protocol, engine=engine, precision="float64") for engine in ("embree", "scanline")
    )
    for material, path_mm in one.path_mm.items():
        assert path_mm.min() > -1e-6
        assert_allclose(path_mm, other.path_mm[material], atol=1e-6)


def test_a_knee_built_in_another_posture_is_refused(built):
    with pytest.raises(
        InputError, match=r"knee must be built in Posture\(projection='PA'.*got Posture\(projection='AP'"
    ):
        pssf.simulate(built, FIXED_FLEXION)


def test_what_is_no_protocol_is_refused():
    with pytest.raises(InputError, match="protocol must be a Protocol or None, got 'fixed_flexion'"):
        pssf.build(pssf.Knee(), "fixed_flexion")


@pytest.mark.parametrize("flexion_deg", [10.0, 40.0])
@pytest.mark.parametrize("seed", range(2))
def test_drawn_knees_can_be_bent(flexion_deg, seed):
    knee = pssf.sample_knee(grade=2, rng=np.random.default_rng(seed), grade_table="paper")
    protocol = dataclasses.replace(FIXED_FLEXION, flexion_deg=flexion_deg, **SMALL)
    assert pssf.build(knee, protocol).scene.surfaces
