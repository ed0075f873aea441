"""Check the alignment angles of the limb."""

import dataclasses

import numpy as np
import pytest

import pssf
from pssf.data.anatomy.bone_tables import load_template_anatomy
from pssf.model.limb_axes import compute_alignment

FEMUR = load_template_anatomy().femur


@pytest.mark.parametrize(("varus_deg", "angle_deg"), [(0.0, 175.0), (5.0, 180.0), (-3.5, 171.5)])
def test_the_lateral_femorotibial_angle_is_175_degrees_plus_varus(varus_deg, angle_deg):
    assert compute_alignment(pssf.Knee(varus_deg=varus_deg), FEMUR)["femorotibial_deg"] == angle_deg


def test_the_hip_knee_ankle_angle_of_a_default_knee_is_near_180_degrees():
    usual, bowed, far = (
        compute_alignment(knee, FEMUR)["hip_knee_ankle_deg"]
        for knee in (pssf.Knee(), pssf.Knee(varus_deg=4.0), pssf.Knee(mechanical_axis_deg=7.5))
    )
    assert (usual, bowed, far) == (180.4, 184.4, 182.5)


def test_limb_alignment_has_four_named_measures():
    read = compute_alignment(pssf.Knee(tibial_slope_deg=7.5, insall_salvati=1.3), FEMUR)
    assert read == {
        "femorotibial_deg": 175.0, "hip_knee_ankle_deg": 180.4, "tibial_slope_deg": 7.5, "insall_salvati": 1.3,
    }  # fmt: skip


def test_the_mechanical_axis_changes_a_label_but_no_pixel():
    near = pssf.Knee()
    far = dataclasses.replace(near, mechanical_axis_deg=7.0)
    coarse = dataclasses.replace(pssf.load_protocol("fixed_flexion"), rows=60, cols=60, pixel_mm=2.0)
    radiographs = [pssf.simulate(knee, coarse, rng=1) for knee in (near, far)]
    assert np.array_equal(radiographs[0].pixels, radiographs[1].pixels)
    angles = [one.truth.readings["hip_knee_ankle_deg"] for one in radiographs]
    assert angles[1] - angles[0] == pytest.approx(1.6)


def test_sampling_the_mechanical_axis_changes_no_other_parameter():
    knees = [
        pssf.sample_knee(grade=2, rng=np.random.default_rng(seed), grade_table="population") for seed in range(200)
    ]
    angles = np.array([knee.mechanical_axis_deg for knee in knees])
    # Tolerances are five standard errors. Truncation at two standard deviations reduces the SD from 0.8 to 0.768.
    assert angles.mean() == pytest.approx(5.4, abs=5 * 0.8 / np.sqrt(200))
    assert angles.std() == pytest.approx(0.768, rel=5 / np.sqrt(2 * 200))
    rng = np.random.default_rng(3)
    assert pssf.sample_knee(grade=2, rng=rng, grade_table="population", mechanical_axis_deg=5.0) == dataclasses.replace(
        knees[3], mechanical_axis_deg=5.0
    )
    right, left = pssf.sample_knee_pair(grade=2, rng=np.random.default_rng(0), grade_table="population")
    assert right.mechanical_axis_deg == left.mechanical_axis_deg
