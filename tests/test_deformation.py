"""Shapes of people's bones: scores, what they move, and what they leave as it was."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pssf
from pssf.anatomy.template.bone_form import build_lattices, build_shape_model
from pssf.data.anatomy.shape_table import load_shape_model
from pssf.geometry.freeform_deformation import min_jacobian_determinant
from pssf.model.knee import MAX_SHAPE_SD, knee_from_dict, knee_to_dict

MODES = len(load_shape_model().modes)
BROAD = pssf.Knee(shape=tuple(np.where(np.arange(MODES) % 2, -1.5, 1.5)), varus_deg=1.0, flexion_deg=4.0)


@pytest.fixture(scope="module")
def broad():
    return pssf.build(BROAD)


def test_the_joint_spaces_of_another_shape_are_what_the_knee_asks_for(broad):
    measured = broad.measure_jsw_mm(pssf.load_protocol("reference"))
    assert measured == pytest.approx((5.0, 5.0), abs=1e-3)


def test_another_shape_moves_the_bones_by_millimetres_and_a_left_one_is_its_mirror(broad):
    mean, left = pssf.build(dataclasses.replace(BROAD, shape=())), pssf.build(dataclasses.replace(BROAD, side="left"))
    for name in ("femur", "tibia", "patella"):
        mine, other, mirrored = (
            next(s for s in built.scene.surfaces if s.name == name).mesh_arrays.vertices
            for built in (broad, mean, left)
        )
        away, _ = cKDTree(other).query(mine)
        assert 0.5 < away.max() < 20
        assert len(mine) == len(mirrored)
        assert np.abs(np.sort(mine[:, 0]) + np.sort(mirrored[:, 0])[::-1]).max() < 1e-9


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_no_mode_folds_a_bone_at_its_farthest(side):
    shapes = build_shape_model(load_shape_model())
    for number in range(MODES):
        for lattice in build_lattices((0.0,) * number + (side * MAX_SHAPE_SD,), shapes).values():
            assert min_jacobian_determinant(lattice) > 0.1


def test_scores_move_control_points_in_proportion_and_add_up():
    shapes = build_shape_model(load_shape_model())
    mean, one, two, both = (
        build_lattices(scores, shapes)["femur"].displacements_mm for scores in ((), (1.0,), (0.0, -2.0), (1.0, -2.0))
    )
    np.testing.assert_allclose(both - mean, (one - mean) + (two - mean), atol=1e-12)


def test_a_shape_is_written_and_read_and_zeros_at_its_end_say_nothing():
    knee = pssf.Knee(shape=(0.5, -1.0, 0.0))
    assert knee.shape == (0.5, -1.0)
    assert knee_from_dict(knee_to_dict(knee)) == knee
    assert pssf.Knee(shape=[0.0]) == pssf.Knee()


@pytest.mark.parametrize(
    ("shape", "line"),
    [
        ((3.5,), "shape score"),
        ((0.0,) * (MODES + 1), "numbers, one per mode"),
        ("12", "numbers, one per mode"),
        (("a",), "a"),
    ],
)
def test_a_shape_that_is_none_is_refused(shape, line):
    with pytest.raises(pssf.InputError, match=line):
        pssf.Knee(shape=shape)


def test_drawn_scores_are_standard_normal_and_of_a_stream_of_their_own():
    knees = [pssf.sample_knee(grade=0, rng=np.random.default_rng(seed), grade_table="paper") for seed in range(300)]
    scores = np.array([(*knee.shape, *(0.0,) * (MODES - len(knee.shape))) for knee in knees])
    assert np.abs(scores.mean(axis=0)).max() < 4 / np.sqrt(300)
    assert np.abs(scores.std(axis=0) - 1).max() < 0.2
    held = pssf.sample_knee(grade=0, rng=np.random.default_rng(7), shape=(), grade_table="paper")
    assert dataclasses.replace(knees[7], shape=()) == held


def test_a_small_osteophyte_on_a_rounded_margin_is_filled_within_its_bone():
    """Its feet stand out of the bone of this drawn knee: their filling was 0.005 mm3 outside, and refused."""
    built = pssf.build(pssf.sample_knee(grade=2, rng=np.random.default_rng(8), grade_table="paper"))
    femur = built.bones["femur"]
    assert (femur.inner - femur.outer).volume() < 1e-6
