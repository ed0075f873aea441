"""OARSI and Kellgren-Lawrence grades computed from the parameters of a knee."""

import numpy as np
import pytest

import pssf
from pssf.data.anatomy.trabecular_table import load_trabecular_bone
from pssf.data.knees.oarsi_table import load_oarsi_thresholds
from pssf.model import oarsi_grades


def compute_readings(knee, attrition_mm):
    return oarsi_grades.compute_oarsi_grades(knee, attrition_mm, load_oarsi_thresholds(), load_trabecular_bone())


def test_a_healthy_knee_has_only_grades_of_zero():
    assert set(compute_readings(pssf.Knee(), {}).values()) == {0}
    assert len(compute_readings(pssf.Knee(), {})) == 1 + 4 + 2 + 4 + 4


@pytest.mark.parametrize(("size_mm", "grade"), [(0.5, 0), (0.8, 1), (1.9, 1), (2.0, 2), (5.0, 3)])
def test_an_osteophyte_is_graded_at_its_own_margin(size_mm, grade):
    readings = compute_readings(pssf.Knee(osteophytes=(pssf.Osteophyte(site="lateral_tibia", size_mm=size_mm),)), {})
    assert readings.pop("XROSTL") == grade
    assert readings.pop("XRKL") == (1 if size_mm < 0.8 else 2)
    assert set(readings.values()) == {0}


def test_narrowing_is_graded_by_jsw_loss_within_the_jsw_definition():
    for definition in load_oarsi_thresholds().healthy_mm:
        for sex in ("male", "female"):
            healthy = load_oarsi_thresholds().healthy_jsw_mm("medial", sex=sex, jsw_definition=definition)
            spaces = [
                healthy * fraction for fraction in (0.9, *(1 - cut - 1e-6 for cut in load_oarsi_thresholds().narrowing))
            ]
            knees = [pssf.Knee(sex=sex, jsw_definition=definition, jsw_medial_mm=space) for space in spaces]
            assert [compute_readings(knee, {})["XRJSM"] for knee in knees] == [0, 1, 2, 3]


def test_joint_space_narrowing_of_sampled_knees_agrees_with_kl_grade():
    most = {}
    for grade in range(5):
        knees = [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng(seed), grade_table="population")
            for seed in range(300)
        ]
        most[grade] = np.array([max(compute_readings(knee, {})[name] for name in ("XRJSM", "XRJSL")) for knee in knees])
    # KL 3 has definite narrowing, KL 0 and 1 do not (Kellgren and Lawrence 1957); sampling error of 300 knees: 0.04.
    assert (most[0] > 0).mean() < 0.10 + 0.04
    assert (most[1] > 0).mean() < 0.10
    assert (most[3] > 0).mean() > 0.96 - 0.04
    assert (most[4] > 1).mean() > 0.95


def test_sclerosis_is_graded_higher_medially_by_default():
    readings = compute_readings(pssf.Knee(subchondral_plate=2.2), {})
    assert readings["XRSCTM"] == 3
    assert readings["XRSCTM"] > readings["XRSCTL"]


def test_sclerosis_is_graded_higher_laterally_if_that_side_is_narrower():
    readings = compute_readings(pssf.Knee(subchondral_plate=2.2, jsw_medial_mm=5.0, jsw_lateral_mm=1.0), {})
    assert readings["XRSCTL"] == 3
    assert readings["XRSCTM"] < 3


@pytest.mark.parametrize(("depth_mm", "grade"), [(0.0, 0), (0.24, 0), (0.3, 1), (1.0, 2), (3.9, 3)])
def test_attrition_is_graded_by_its_depth_per_compartment(depth_mm, grade):
    readings = compute_readings(pssf.Knee(), {"medial": 0.0, "lateral": depth_mm})
    assert (readings["XRATTM"], readings["XRATTL"]) == (0, grade)


def test_cysts_are_graded_as_present_or_absent_per_compartment():
    cysts = tuple(pssf.Cyst(site="medial_tibia", diameter_mm=mm, place=at) for mm, at in ((2.0, -0.5), (5.0, 0.5)))
    readings = compute_readings(pssf.Knee(cysts=cysts), {})
    assert readings.pop("XRCYTM") == 1
    assert set(readings.values()) == {0}
