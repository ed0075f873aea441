import numpy as np
import pytest

import pssf
from pssf.data.anatomy.trabecular_table import load_trabecular_bone
from pssf.data.knees.oarsi_table import load_oarsi_thresholds
from pssf.model import oarsi_grades as readings_of


def oarsi(knee, attrition_mm):
    return readings_of.compute_oarsi_grades(knee, attrition_mm, load_oarsi_thresholds(), load_trabecular_bone())


def test_a_healthy_knee_has_no_grade_above_0():
    assert set(oarsi(pssf.Knee(), {}).values()) == {0}
    assert len(oarsi(pssf.Knee(), {})) == 1 + 4 + 2 + 4 + 4


@pytest.mark.parametrize(("size_mm", "grade"), [(0.5, 0), (0.8, 1), (1.9, 1), (2.0, 2), (5.0, 3)])
def test_an_osteophyte_is_graded_at_its_own_margin(size_mm, grade):
    readings = oarsi(pssf.Knee(osteophytes=(pssf.Osteophyte(site="lateral_tibia", size_mm=size_mm),)), {})
    assert readings.pop("XROSTL") == grade
    assert readings.pop("XRKL") == (1 if size_mm < 0.8 else 2)
    assert set(readings.values()) == {0}


def test_a_space_is_graded_by_what_is_lost_of_the_way_it_is_measured():
    for measured in load_oarsi_thresholds().healthy_mm:
        for sex in ("male", "female"):
            healthy = load_oarsi_thresholds().healthy_jsw_mm("medial", sex=sex, jsw_definition=measured)
            spaces = [
                healthy * share for share in (0.9, *(1 - cut - 1e-6 for cut in load_oarsi_thresholds().narrowing))
            ]
            knees = [pssf.Knee(sex=sex, jsw_definition=measured, jsw_medial_mm=space) for space in spaces]
            assert [oarsi(knee, {})["XRJSM"] for knee in knees] == [0, 1, 2, 3]


def test_drawn_knees_narrow_as_their_grade_is_defined():
    most = {}
    for grade in range(5):
        knees = [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng(seed), grade_table="population")
            for seed in range(300)
        ]
        most[grade] = np.array([max(oarsi(knee, {})[name] for name in ("XRJSM", "XRJSL")) for knee in knees])
    # KL 0 and 1 have no definite narrowing, KL 3 has (Kellgren and Lawrence 1957); 300 knees give a share to 4 points.
    assert (most[0] > 0).mean() < 0.10 + 0.04
    assert (most[1] > 0).mean() < 0.10
    assert (most[3] > 0).mean() > 0.96 - 0.04
    assert (most[4] > 1).mean() > 0.95


def test_sclerosis_is_read_medially_before_laterally():
    readings = oarsi(pssf.Knee(subchondral_plate=2.2), {})
    assert readings["XRSCTM"] == 3
    assert readings["XRSCTM"] > readings["XRSCTL"]


def test_sclerosis_is_read_laterally_where_that_side_narrows():
    readings = oarsi(pssf.Knee(subchondral_plate=2.2, jsw_medial_mm=5.0, jsw_lateral_mm=1.0), {})
    assert readings["XRSCTL"] == 3
    assert readings["XRSCTM"] < 3


@pytest.mark.parametrize(("depth_mm", "grade"), [(0.0, 0), (0.24, 0), (0.3, 1), (1.0, 2), (3.9, 3)])
def test_attrition_is_graded_by_its_depth_on_its_own_side(depth_mm, grade):
    readings = oarsi(pssf.Knee(), {"medial": 0.0, "lateral": depth_mm})
    assert (readings["XRATTM"], readings["XRATTL"]) == (0, grade)


def test_a_compartment_has_cysts_or_none():
    cysts = tuple(pssf.Cyst(site="medial_tibia", diameter_mm=mm, place=at) for mm, at in ((2.0, -0.5), (5.0, 0.5)))
    readings = oarsi(pssf.Knee(cysts=cysts), {})
    assert readings.pop("XRCYTM") == 1
    assert set(readings.values()) == {0}
