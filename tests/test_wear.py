"""Attrition: bones that would stand in each other are worn to contact, and nothing else changes."""

import dataclasses

import pytest
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy.solids import solid_of
from pssf.anatomy.wear import worn

FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
WORN = pssf.Knee(jsw_as="read", jsw_medial_mm=0.1, jsw_lateral_mm=4.0, varus_deg=5.0, grade=4)


@pytest.fixture(scope="module")
def built():
    return pssf.build(WORN, FIXED_FLEXION)


def test_bone_on_bone_is_built_without_overlap_and_with_its_spaces(built):
    assert (built.bones["femur"].outer ^ built.bones["tibia"].outer).volume() < 1e-6
    assert_allclose(built.measured_jsw_mm(FIXED_FLEXION), (0.1, 4.0), atol=1e-3)
    assert str(pssf.check(built.scene)) == "no faults"


def test_only_the_plateau_under_the_femur_is_worn(built, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("pssf.anatomy.built.worn", lambda tibia, femur, plate_mm: tibia)
        patch.setattr("pssf.anatomy.built._check_nesting", lambda placed, muscle: None)
        bare = pssf.build(WORN, FIXED_FLEXION)
    before, after = (knee.bones["tibia"].outer for knee in (bare, built))
    gone = before - after
    assert gone.volume() > 1.0
    assert (after - before).volume() < 1e-6
    # What is gone lies within the femur and the contact around it.
    femur = built.bones["femur"].outer
    assert (gone - femur).volume() < 0.3 * gone.volume() + 20.0
    assert gone.bounding_box()[2] > -12.0


def test_cartilage_stays_out_of_bones_and_of_each_other(built):
    names = ("femur", "tibia", "femur_cartilage", "tibia_cartilage", "medial_meniscus", "lateral_meniscus")
    solids = [
        solid_of(surface.arrays.vertices, surface.arrays.faces, surface.name)
        for surface in built.scene.surfaces
        if surface.name in names
    ]
    for number, one in enumerate(solids):
        for other in solids[number + 1 :]:
            assert (one ^ other).volume() < 1e-4


def test_what_is_not_worn_is_the_same_object_as_before():
    wide = dataclasses.replace(WORN, jsw_medial_mm=4.0, varus_deg=0.0)
    one = pssf.build(wide, FIXED_FLEXION)
    assert_allclose(one.measured_jsw_mm(FIXED_FLEXION), (4.0, 4.0), atol=1e-3)
    assert worn(one.bones["tibia"], one.bones["femur"].outer, 0.3) is one.bones["tibia"]
