"""The tibia beside the femur: by so many millimetres, in every posture, with the joint spaces that were asked for."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from standing import standing_bones

import pssf
from pssf import InputError, Knee
from pssf.anatomy.bone_build import build_of
from pssf.anatomy.contours import measure_gap
from pssf.anatomy.joint import assemble, defining_protocol
from pssf.anatomy.pose import moved
from pssf.anatomy.solids import edges_of, mesh_of
from pssf.data.anatomy import anatomy_tables
from pssf.geometry.view import view_of
from pssf.model.protocol import Posture

FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
REFERENCE = pssf.load_protocol("reference")


def standing(knee, posture):
    """How it stands, and its bones without soft tissue."""
    assembly = assemble(knee, build_of(knee, anatomy_tables()), posture, defining_protocol(knee))
    return assembly, standing_bones(knee, assembly)


@pytest.mark.parametrize("slipped_mm", [-6.0, 3.0, 6.0])
def test_the_femur_stands_so_far_to_medial_on_the_tibia_and_spaces_are_kept(slipped_mm):
    knee = Knee(jsw_medial_mm=1.5, jsw_lateral_mm=5.0, subluxation_mm=slipped_mm)
    assembly, placed = standing(knee, Posture())
    there, _ = standing(dataclasses.replace(knee, subluxation_mm=0.0), Posture())
    # Of the femur's lower end, which the tilt that keeps the spaces moves by a tenth or two.
    middle = np.zeros((1, 3))
    one, other = ((at.femur_mm(middle) - at.tibia_mm(middle))[0, 0] for at in (assembly, there))
    assert one - other == pytest.approx(slipped_mm, abs=0.25)
    femur, tibia = (mesh_of(placed[name].outer) for name in ("femur", "tibia"))
    gaps = [
        measure_gap(
            (femur.vertices, edges_of(femur.faces)), (tibia.vertices, edges_of(tibia.faces)), view_of(REFERENCE), side,
            assembly.build.half_ml_mm, assembly.pose.lean_deg,
        ).jsw_mm
        for side in (+1, -1)
    ]  # fmt: skip
    assert_allclose(gaps, (1.5, 5.0), atol=1e-3)
    assert (placed["femur"].outer ^ placed["tibia"].outer).volume() < 1e-6


@pytest.mark.parametrize("posture", [FIXED_FLEXION.posture, Posture()])
def test_a_bent_knee_has_slipped_as_far(posture):
    slipped = Knee(jsw_as="read", jsw_medial_mm=2.0, jsw_lateral_mm=5.0, subluxation_mm=4.0)
    tables, protocol = anatomy_tables(), defining_protocol(slipped)
    poses = [
        assemble(knee, build_of(knee, tables), posture, protocol).pose
        for knee in (slipped, dataclasses.replace(slipped, subluxation_mm=0.0))
    ]
    # Of the place that the femur bends and turns about; the tilt that keeps the spaces moves it by some tenths.
    one, other = (moved(np.array([pose.pivot_mm]), pose.femur_on_tibia())[0, 0] for pose in poses)
    assert one - other == pytest.approx(4.0, abs=0.5)
    assert [pose.medial_mm for pose in poses] == [4.0, 0.0]


def test_a_subluxed_knee_is_built_without_faults_with_its_spaces():
    knee = Knee(jsw_as="read", jsw_medial_mm=0.8, jsw_lateral_mm=4.5, varus_deg=4.0, subluxation_mm=5.0, side="left")
    built = pssf.build(knee, FIXED_FLEXION)
    assert str(pssf.check(built.scene)) == "no faults"
    assert_allclose(built.measured_jsw_mm(FIXED_FLEXION), (0.8, 4.5), atol=1e-3)


def test_it_is_bounded_and_drawn_where_the_medial_side_of_an_advanced_knee_narrows():
    with pytest.raises(InputError, match="subluxation_mm = 7"):
        Knee(subluxation_mm=7.0)
    for grade in range(5):
        knees = [
            pssf.draw_knee(grade=grade, rng=np.random.default_rng((3, grade, k)), grade_table="population")
            for k in range(200)
        ]
        slipped = np.array([knee.subluxation_mm for knee in knees])
        narrow = np.array([knee.jsw_medial_mm < knee.jsw_lateral_mm for knee in knees])
        assert ((slipped >= 0) & (slipped <= 5)).all()
        assert (slipped > 0).any() == (grade > 2)
        if grade > 2:
            assert 0.2 < slipped[narrow].mean() < 1.0
            assert slipped[~narrow].mean() < 0.5
