"""The tibia beside the femur: by so many millimetres, in every posture, with the joint spaces that were asked for."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from standing import standing_bones

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


def standing(knee, posture):
    """How it stands, and its bones without soft tissue."""
    assembly = assemble_knee(
        knee, resolve_bone_parameters(knee, load_anatomy_tables()), posture, load_jsw_protocol(knee)
    )
    return assembly, standing_bones(knee, assembly)


@pytest.mark.parametrize("slipped_mm", [-6.0, 3.0, 6.0])
def test_the_femur_stands_so_far_to_medial_on_the_tibia_and_spaces_are_kept(slipped_mm):
    knee = Knee(jsw_medial_mm=1.5, jsw_lateral_mm=5.0, subluxation_mm=slipped_mm)
    assembly, placed = standing(knee, Posture())
    there, _ = standing(dataclasses.replace(knee, subluxation_mm=0.0), Posture())
    # Of the femur's lower end, which the tilt that keeps the spaces moves by a tenth or two.
    middle = np.zeros((1, 3))
    one, other = ((at.place_femur_points(middle) - at.place_tibia_points(middle))[0, 0] for at in (assembly, there))
    assert one - other == pytest.approx(slipped_mm, abs=0.25)
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
def test_a_bent_knee_has_slipped_as_far(posture):
    slipped = Knee(jsw_definition="read", jsw_medial_mm=2.0, jsw_lateral_mm=5.0, subluxation_mm=4.0)
    tables, protocol = load_anatomy_tables(), load_jsw_protocol(slipped)
    poses = [
        assemble_knee(knee, resolve_bone_parameters(knee, tables), posture, protocol).pose
        for knee in (slipped, dataclasses.replace(slipped, subluxation_mm=0.0))
    ]
    # Of the place that the femur bends and turns about; the tilt that keeps the spaces moves it by some tenths.
    one, other = (apply_transform(np.array([pose.pivot_mm]), pose.femur_to_tibia_transform())[0, 0] for pose in poses)
    assert one - other == pytest.approx(4.0, abs=0.5)
    assert [pose.medial_shift_mm for pose in poses] == [4.0, 0.0]


def test_a_subluxed_knee_is_built_without_faults_with_its_spaces():
    knee = Knee(
        jsw_definition="read", jsw_medial_mm=0.8, jsw_lateral_mm=4.5, varus_deg=4.0, subluxation_mm=5.0, side="left"
    )
    built = pssf.build(knee, FIXED_FLEXION)
    assert str(pssf.check(built.scene)) == "no faults"
    assert_allclose(built.measure_jsw_mm(FIXED_FLEXION), (0.8, 4.5), atol=1e-3)


def test_it_is_bounded_and_drawn_where_the_medial_side_of_an_advanced_knee_narrows():
    with pytest.raises(InputError, match=r"subluxation_mm must be .*, got 7"):
        Knee(subluxation_mm=7.0)
    for grade in range(5):
        knees = [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng((3, grade, k)), grade_table="population")
            for k in range(200)
        ]
        slipped = np.array([knee.subluxation_mm for knee in knees])
        narrow = np.array([knee.jsw_medial_mm < knee.jsw_lateral_mm for knee in knees])
        assert ((slipped >= 0) & (slipped <= 5)).all()
        assert (slipped > 0).any() == (grade > 2)
        if grade > 2:
            assert 0.2 < slipped[narrow].mean() < 1.0
            assert slipped[~narrow].mean() < 0.5
