"""Check the bone shape model: scores, deformation of the bones and invariants."""

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
EXTREME_KNEE = pssf.Knee(shape=tuple(np.where(np.arange(MODES) % 2, -1.5, 1.5)), varus_deg=1.0, flexion_deg=4.0)


@pytest.fixture(scope="module")
def extreme_knee():
    return pssf.build(EXTREME_KNEE)


def test_the_joint_spaces_of_an_extreme_shape_are_as_specified(extreme_knee):
    measured = extreme_knee.measure_jsw_mm(pssf.load_protocol("reference"))
    assert measured == pytest.approx((5.0, 5.0), abs=1e-3)


def test_an_extreme_shape_moves_bones_by_millimetres_and_can_be_mirrored(extreme_knee):
    mean, left = (
        pssf.build(dataclasses.replace(EXTREME_KNEE, shape=())),
        pssf.build(dataclasses.replace(EXTREME_KNEE, side="left")),
    )
    for name in ("femur", "tibia", "patella"):
        mine, other, mirrored = (
            next(s for s in built.scene.surfaces if s.name == name).mesh_arrays.vertices
            for built in (extreme_knee, mean, left)
        )
        distances_mm, _ = cKDTree(other).query(mine)
        assert 0.5 < distances_mm.max() < 20
        assert len(mine) == len(mirrored)
        assert np.abs(np.sort(mine[:, 0]) + np.sort(mirrored[:, 0])[::-1]).max() < 1e-9


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_no_bone_folds_at_the_limits_of_a_shape_mode(side):
    shapes = build_shape_model(load_shape_model())
    for number in range(MODES):
        for lattice in build_lattices((0.0,) * number + (side * MAX_SHAPE_SD,), shapes).values():
            assert min_jacobian_determinant(lattice) > 0.1


def test_control_point_displacements_are_linear_in_the_scores():
    shapes = build_shape_model(load_shape_model())
    mean, one, two, both = (
        build_lattices(scores, shapes)["femur"].displacements_mm for scores in ((), (1.0,), (0.0, -2.0), (1.0, -2.0))
    )
    np.testing.assert_allclose(both - mean, (one - mean) + (two - mean), atol=1e-12)


def test_a_shape_survives_conversion_without_trailing_zeros():
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
def test_an_invalid_shape_is_rejected(shape, line):
    with pytest.raises(pssf.InputError, match=line):
        pssf.Knee(shape=shape)


def test_sampled_shape_scores_are_standard_normal_and_independent():
    knees = [pssf.sample_knee(grade=0, rng=np.random.default_rng(seed), grade_table="paper") for seed in range(300)]
    scores = np.array([(*knee.shape, *(0.0,) * (MODES - len(knee.shape))) for knee in knees])
    assert np.abs(scores.mean(axis=0)).max() < 4 / np.sqrt(300)
    assert np.abs(scores.std(axis=0) - 1).max() < 0.2
    with_mean_shape = pssf.sample_knee(grade=0, rng=np.random.default_rng(7), shape=(), grade_table="paper")
    assert dataclasses.replace(knees[7], shape=()) == with_mean_shape


def test_a_small_osteophyte_on_a_rounded_margin_stays_inside_its_bone():
    """Check a knee whose osteophyte interior formerly protruded from the bone by 0.005 mm3, which raised an error."""
    built = pssf.build(pssf.sample_knee(grade=2, rng=np.random.default_rng(8), grade_table="paper"))
    femur = built.bones["femur"]
    assert (femur.inner - femur.outer).volume() < 1e-6
