"""Check subluxation: the femur is shifted on the tibia in every posture, with the specified JSW."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from posed_bones import build_posed_bones

import pssf
from pssf import InputError, Knee
from pssf.anatomy.meshing.rigid_pose import apply_transform
from pssf.anatomy.meshing.solids import extract_mesh, find_edges
from pssf.anatomy.outlines.projected_contours import measure_gap
from pssf.anatomy.posture.knee_assembly import assemble_knee, load_jsw_protocol
from pssf.anatomy.template.bone_builder import resolve_bone_parameters
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.geometry.view import resolve_view
from pssf.model.protocol import Posture

FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
REFERENCE = pssf.load_protocol("reference")


def assemble_and_build(knee, posture):
    """Assemble a knee in a posture and build its bones without soft tissue."""
    assembly = assemble_knee(
        knee, resolve_bone_parameters(knee, load_anatomy_tables()), posture, load_jsw_protocol(knee)
    )
    return assembly, build_posed_bones(knee, assembly)


@pytest.mark.parametrize("subluxation_mm", [-6.0, 3.0, 6.0])
def test_subluxation_shifts_the_femur_medially_without_changing_jsw(subluxation_mm):
    knee = Knee(jsw_medial_mm=1.5, jsw_lateral_mm=5.0, subluxation_mm=subluxation_mm)
    assembly, placed = assemble_and_build(knee, Posture())
    unshifted, _ = assemble_and_build(dataclasses.replace(knee, subluxation_mm=0.0), Posture())
    # The lower end of the femur is compared; the tilt that keeps the joint spaces moves it by 0.1 to 0.2 mm.
    middle = np.zeros((1, 3))
    one, other = ((at.place_femur_points(middle) - at.place_tibia_points(middle))[0, 0] for at in (assembly, unshifted))
    assert one - other == pytest.approx(subluxation_mm, abs=0.25)
    femur, tibia = (extract_mesh(placed[name].outer) for name in ("femur", "tibia"))
    gaps = [
        measure_gap(
            (femur.vertices, find_edges(femur.faces)), (tibia.vertices, find_edges(tibia.faces)),
            resolve_view(REFERENCE), side,
            assembly.bone_parameters.half_ml_mm, assembly.pose.lean_deg,
        ).jsw_mm
        for side in (+1, -1)
    ]  # fmt: skip
    assert_allclose(gaps, (1.5, 5.0), atol=1e-3)
    assert (placed["femur"].outer ^ placed["tibia"].outer).volume() < 1e-6


@pytest.mark.parametrize("posture", [FIXED_FLEXION.posture, Posture()])
def test_a_flexed_knee_has_the_same_subluxation(posture):
    shifted = Knee(jsw_definition="read", jsw_medial_mm=2.0, jsw_lateral_mm=5.0, subluxation_mm=4.0)
    tables, protocol = load_anatomy_tables(), load_jsw_protocol(shifted)
    poses = [
        assemble_knee(knee, resolve_bone_parameters(knee, tables), posture, protocol).pose
        for knee in (shifted, dataclasses.replace(shifted, subluxation_mm=0.0))
    ]
    # The pivot of the femur is compared; the tilt that keeps the joint spaces moves it by a few tenths of a mm.
    one, other = (apply_transform(np.array([pose.pivot_mm]), pose.femur_to_tibia_transform())[0, 0] for pose in poses)
    assert one - other == pytest.approx(4.0, abs=0.5)
    assert [pose.medial_shift_mm for pose in poses] == [4.0, 0.0]


def test_a_subluxed_knee_has_no_faults_and_the_specified_jsw():
    knee = Knee(
        jsw_definition="read", jsw_medial_mm=0.8, jsw_lateral_mm=4.5, varus_deg=4.0, subluxation_mm=5.0, side="left"
    )
    built = pssf.build(knee, FIXED_FLEXION)
    assert str(pssf.check(built.scene)) == "no faults"
    assert_allclose(built.measure_jsw_mm(FIXED_FLEXION), (0.8, 4.5), atol=1e-3)


def test_subluxation_is_sampled_in_advanced_medial_disease():
    with pytest.raises(InputError, match=r"subluxation_mm must be .*, got 7"):
        Knee(subluxation_mm=7.0)
    for grade in range(5):
        knees = [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng((3, grade, k)), grade_table="population")
            for k in range(200)
        ]
        shifted = np.array([knee.subluxation_mm for knee in knees])
        narrow = np.array([knee.jsw_medial_mm < knee.jsw_lateral_mm for knee in knees])
        assert ((shifted >= 0) & (shifted <= 5)).all()
        assert (shifted > 0).any() == (grade > 2)
        if grade > 2:
            assert 0.2 < shifted[narrow].mean() < 1.0
            assert shifted[~narrow].mean() < 0.5
