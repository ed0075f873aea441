"""A refusal of solids names the parameters of the knee that conflict."""

import pytest

import pssf
from pssf.anatomy.bones.parameter_conflicts import SolidConflictError, explain_conflicts
from pssf.model.protocol import Posture


def refusal(error, posture=None, **fields):
    with pytest.raises(pssf.InputError) as refused, explain_conflicts(pssf.Knee(**fields), posture or Posture()):
        raise error
    return str(refused.value)


def test_a_cortex_outside_of_muscle_is_told_by_the_size_of_bones_and_limb():
    error = SolidConflictError("cortex of the femur must be inside the solid around it, got 4.8e+03 mm3 outside")
    told = refusal(error, bone_scale=1.15, limb_ap_mm=90, varus_deg=16, insall_salvati=1.8)
    assert told.startswith("bone_scale = 1.15 (usual 1), limb_ap_mm = 90 mm (usual ")
    assert "must be compatible, got a failed check (cortex of the femur must be inside the solid around" in told
    assert "varus_deg" not in told
    assert "insall_salvati" not in told


def test_bones_that_overlap_are_told_by_spaces_pose_osteophytes_and_shape():
    error = SolidConflictError("patella and femur must not overlap, got 3 mm3 of overlap: no clearance")
    beaks = (pssf.Osteophyte(site="medial_femur", size_mm=6.5), pssf.Osteophyte(site="lateral_femur", size_mm=1.0))
    posture = Posture(flexion_deg=45.0)
    told = refusal(error, posture, jsw_lateral_mm=0.0, insall_salvati=0.6, osteophytes=beaks, shape=(0.0, -2.5))
    for part in (
        "jsw_lateral_mm = 0 mm (usual 5)",
        "insall_salvati = 0.6 (usual 1.14)",
        "osteophytes (medial_femur 6.5 mm)",
        "shape (scores -2.5)",
        "flexion of 45 deg",
    ):
        assert part in told
    assert "lateral_femur" not in told


def test_a_solid_that_fails_is_told_by_parameters_too():
    told = refusal(pssf.InputError("solid tibia must have status NoError, got status NotManifold"), tibial_slope_deg=18)
    assert told.startswith("tibial_slope_deg = 18 deg (usual 5) must")


def test_a_refusal_that_names_parameters_stays_as_it_is():
    error = pssf.InputError("jsw_medial_mm and jsw_lateral_mm must be possible in one pose, got 0 mm and 10 mm")
    assert refusal(error, jsw_medial_mm=0.0, jsw_lateral_mm=10.0) == str(error)
