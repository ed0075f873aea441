"""Check that errors of solids name the conflicting parameters of the knee."""

import pytest

import pssf
from pssf.anatomy.bones.parameter_conflicts import SolidConflictError, explain_conflicts
from pssf.model.protocol import Posture


def explain_error(error, posture=None, **fields):
    """Return the message of `explain_conflicts` for an error and a knee with changed fields."""
    with pytest.raises(pssf.InputError) as raised, explain_conflicts(pssf.Knee(**fields), posture or Posture()):
        raise error
    return str(raised.value)


def test_the_error_for_cortex_outside_muscle_names_bone_and_limb_size():
    error = SolidConflictError("cortex of the femur must be inside the solid around it, got 4.8e+03 mm3 outside")
    message = explain_error(error, bone_scale=1.15, limb_ap_mm=90, varus_deg=16, insall_salvati=1.8)
    assert message.startswith("bone_scale = 1.15 (usual 1), limb_ap_mm = 90 mm (usual ")
    assert "are incompatible: cortex of the femur must be inside the solid around it, got 4.8e+03 mm3" in message
    assert "varus_deg" not in message
    assert "insall_salvati" not in message


def test_the_error_for_overlapping_bones_names_possible_causes():
    error = SolidConflictError("patella and femur must not overlap, got 3 mm3 of overlap: no clearance")
    osteophytes = (
        pssf.Osteophyte(site="medial_femur", size_mm=6.5),
        pssf.Osteophyte(site="lateral_femur", size_mm=1.0),
    )
    posture = Posture(flexion_deg=45.0)
    message = explain_error(
        error, posture, jsw_lateral_mm=0.0, insall_salvati=0.6, osteophytes=osteophytes, shape=(0.0, -2.5)
    )
    for part in (
        "jsw_lateral_mm = 0 mm (usual 5)",
        "insall_salvati = 0.6 (usual 1.14)",
        "osteophytes (medial_femur 6.5 mm)",
        "shape scores (-2.5)",
        "flexion of 45 deg",
    ):
        assert part in message
    assert "lateral_femur" not in message


def test_the_error_for_an_invalid_solid_names_parameters():
    message = explain_error(
        pssf.InputError("solid tibia must have status NoError, got status NotManifold"), tibial_slope_deg=18
    )
    assert message.startswith("tibial_slope_deg = 18 deg (usual 5) are incompatible: ")


def test_an_error_that_already_names_parameters_is_unchanged():
    error = pssf.InputError("jsw_medial_mm and jsw_lateral_mm must be possible in the same pose, got 0 mm and 10 mm")
    assert explain_error(error, jsw_medial_mm=0.0, jsw_lateral_mm=10.0) == str(error)
