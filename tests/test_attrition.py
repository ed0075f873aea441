"""Check attrition: bones that would overlap are worn until they are in contact, and nothing else changes."""

import dataclasses

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy.bones.bone_shells import Bone
from pssf.anatomy.bones.plateau_wear import ROUNDING_MM3, wear_outer_tibia, wear_tibia
from pssf.anatomy.meshing.solids import build_solid
from pssf.anatomy.posture.attrition import build_outer_meshes, measure_attrition_mm
from pssf.anatomy.posture.knee_assembly import assemble_knee, load_jsw_protocol
from pssf.anatomy.template.bone_builder import resolve_bone_parameters
from pssf.cohort.cohort_plan import plan_cohort
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.model.protocol import Posture

FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
WORN = pssf.Knee(jsw_definition="read", jsw_medial_mm=0.1, jsw_lateral_mm=4.0, varus_deg=5.0)


@pytest.fixture(scope="module")
def built():
    return pssf.build(WORN, FIXED_FLEXION)


@pytest.mark.parametrize("jsw_medial_mm", [0.1, 0.0])
def test_bone_on_bone_contact_has_no_overlap_and_the_specified_jsw(built, jsw_medial_mm):
    if jsw_medial_mm != WORN.jsw_medial_mm:
        built = pssf.build(dataclasses.replace(WORN, jsw_medial_mm=jsw_medial_mm), FIXED_FLEXION)
    femur, tibia = (built.bones[name].outer for name in ("femur", "tibia"))
    assert (femur ^ tibia).volume() < 1e-6
    # The bones are in contact: lowering the femur by the remaining gap makes it overlap the tibia.
    assert (femur.translate((0.0, 0.0, -0.03)) ^ tibia).volume() > 1e-3
    assert_allclose(built.measure_jsw_mm(FIXED_FLEXION), (jsw_medial_mm, 4.0), atol=1e-3)
    assert str(pssf.check(built.scene)) == "no faults"


# In these knees a worn spine moves the plateau floor, or the plateau wears almost as fast as the femur descends.
@pytest.mark.parametrize("number", [559, pytest.param(1039, marks=pytest.mark.slow)])
def test_jsw_is_as_specified_over_a_worn_plateau(number):
    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(1,)))
    knee = pssf.sample_knee(grade=4, rng=rng, grade_table="population")
    built = pssf.build(knee, FIXED_FLEXION)
    assert built.truth(FIXED_FLEXION).attrition_mm["medial"] > 0
    wanted = (knee.jsw_medial_mm, knee.jsw_lateral_mm)
    assert_allclose(built.measure_jsw_mm(FIXED_FLEXION), wanted, atol=1e-3)


# The femur has a thin edge on a central osteophyte of a condyle without joint space.
THIN = pssf.Knee(
    sex="female", stature_mm=1545.6228, jsw_medial_mm=0.112, jsw_lateral_mm=4.3617, jsw_definition="read",
    osteophytes=(
        pssf.Osteophyte(site="medial_femur", size_mm=1.076, curve_deg=-7.981),
        pssf.Osteophyte(site="lateral_femur", size_mm=0.939, curve_deg=-12.339),
        pssf.Osteophyte(site="medial_condyle", size_mm=1.7823, place=0.3424),
    ),
    varus_deg=1.6224, flexion_deg=1.9974, rotation_deg=2.1366, bone_scale=1.1387, tibial_slope_deg=10.4127,
    lean_deg=9.3979, form_seed=5869272677300090416, texture_seed=5869272677300090416, subluxation_mm=0.7405,
    notch_growth_mm=1.5636,
    shape=(
        -0.9818, -1.9165, 0.8227, 0.006, -1.9035, -0.2679, -0.6662, 1.8971, -0.1211, 1.3867, 0.0949, -0.3016, 1.8122,
    ),
)  # fmt: skip


def test_a_thin_edge_of_the_femur_does_not_overlap_the_tibia():
    built = pssf.build(THIN, pssf.load_protocol("fixed_flexion"))
    assert (built.bones["femur"].outer ^ built.bones["tibia"].outer).volume() < 1e-9


def test_fragments_of_a_worn_plateau_are_removed():
    slab = trimesh.creation.box((40.0, 40.0, 10.0)).apply_translation((0.0, 0.0, -5.0))
    block = trimesh.creation.box((20.0, 20.0, 10.0)).apply_translation((0.0, 0.0, 3.0))
    hollow = trimesh.creation.box((0.3, 0.3, 0.3)).apply_translation((0.0, 0.0, -1.0))
    tibia, femur, crumb = (build_solid(part.vertices, part.faces, "part") for part in (slab, block, hollow))
    left = wear_tibia(Bone(outer=tibia, inner=tibia), femur - crumb, 0.1)
    assert len(left.outer.decompose()) == len(left.inner.decompose()) == 1
    assert len(wear_outer_tibia(tibia, femur - crumb).decompose()) == 2
    assert_allclose(left.outer.volume(), 16000.0 - 800.0, rtol=1e-3)


def test_only_the_plateau_below_the_femur_is_worn(built, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("pssf.anatomy.posture.placed_bones.wear_tibia", lambda tibia, femur, plate_mm: tibia)
        patch.setattr("pssf.anatomy.built_knee.check_nesting", lambda placed, muscle: None)
        bare = pssf.build(WORN, FIXED_FLEXION)
    before, after = (knee.bones["tibia"].outer for knee in (bare, built))
    gone = before - after
    assert gone.volume() > 1.0
    assert (after - before).volume() < 1e-6
    # Bone is removed only inside the femur and the contact zone around the femur.
    femur = built.bones["femur"].outer
    assert (gone - femur).volume() < 0.3 * gone.volume() + 20.0
    assert gone.bounding_box()[2] > -12.0


def test_bones_cartilage_and_menisci_do_not_overlap(built):
    names = ("femur", "tibia", "femur_cartilage", "tibia_cartilage", "medial_meniscus", "lateral_meniscus")
    solids = [
        build_solid(surface.mesh_arrays.vertices, surface.mesh_arrays.faces, surface.name)
        for surface in built.scene.surfaces
        if surface.name in names
    ]
    for number, one in enumerate(solids):
        for other in solids[number + 1 :]:
            assert (one ^ other).volume() < 1e-4


def test_an_unworn_tibia_is_returned_unchanged():
    wide = dataclasses.replace(WORN, jsw_medial_mm=4.0, varus_deg=0.0)
    one = pssf.build(wide, FIXED_FLEXION)
    assert_allclose(one.measure_jsw_mm(FIXED_FLEXION), (4.0, 4.0), atol=1e-3)
    assert wear_tibia(one.bones["tibia"], one.bones["femur"].outer, 0.3) is one.bones["tibia"]


def test_attrition_is_the_depth_of_bone_removed_from_the_plateau(built, monkeypatch):
    depths = built.truth(FIXED_FLEXION).attrition_mm
    assert depths["lateral"] == 0.0
    after = build_outer_meshes(built.assembly)[1]
    monkeypatch.setattr("pssf.anatomy.posture.attrition.wear_outer_tibia", lambda tibia, femur: tibia)
    before = build_outer_meshes(built.assembly)[1]
    # Depths are sampled on a grid, so the largest one is slightly below the true maximum.
    gone = _measure_heights(before) - _measure_heights(after)
    assert depths["medial"] - 0.02 < np.nanmax(gone) < depths["medial"] + 0.002


def _measure_heights(tibia):
    """Measure the height (n,) of the medial plateau on a 0.5 mm grid; heights outside the plateau are nan."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(14.0, 40.0, 0.5), np.arange(-30.0, 30.0, 0.5)))
    above = np.column_stack((x, y, np.full(len(x), 50.0)))
    mesh = trimesh.Trimesh(tibia.vertices, tibia.faces, process=False)
    points, rays, _ = mesh.ray.intersects_location(above, np.tile((0.0, 0.0, -1.0), (len(x), 1)), multiple_hits=False)
    heights = np.full(len(x), np.nan)
    heights[rays] = points[:, 2]
    return heights


def test_attrition_does_not_depend_on_the_posture():
    tables, protocol = load_anatomy_tables(), load_jsw_protocol(WORN)
    flexed, straight = (
        assemble_knee(WORN, resolve_bone_parameters(WORN, tables), posture, protocol)
        for posture in (FIXED_FLEXION.posture, Posture())
    )
    assert measure_attrition_mm(flexed) == measure_attrition_mm(straight)
    assert measure_attrition_mm(flexed)["medial"] > 0.25


def test_a_left_knee_has_the_attrition_of_a_right_knee(built):
    mirrored = dataclasses.replace(WORN, side="left")
    left = assemble_knee(
        mirrored,
        resolve_bone_parameters(mirrored, load_anatomy_tables()),
        FIXED_FLEXION.posture,
        load_jsw_protocol(mirrored),
    )
    assert measure_attrition_mm(left) == built.truth(FIXED_FLEXION).attrition_mm


def test_separate_bones_have_no_attrition():
    wide = dataclasses.replace(WORN, jsw_medial_mm=4.0, varus_deg=0.0)
    assembly = assemble_knee(
        wide, resolve_bone_parameters(wide, load_anatomy_tables()), FIXED_FLEXION.posture, load_jsw_protocol(wide)
    )
    assert measure_attrition_mm(assembly) == {"medial": 0.0, "lateral": 0.0}


@pytest.mark.parametrize("wide_mm", [0.0, 4.0])
@pytest.mark.parametrize("protocol", [FIXED_FLEXION, None], ids=["as defined", "straight"])
def test_a_built_knee_stores_the_attrition_of_its_assembly(wide_mm, protocol):
    knee = dataclasses.replace(WORN, jsw_medial_mm=wide_mm, varus_deg=0.0) if wide_mm else WORN
    built = pssf.build(knee, protocol)
    assert built._attrition_by_side_mm == measure_attrition_mm(built.assembly)


def test_a_sampled_knee_whose_worn_bones_nearly_coincide_can_be_built():
    cases = plan_cohort("population", seed=1, overrides={"knees": [1, 1, 1, 1, 1], "acquisition": "sampled"}).cases
    (case,) = [case for case in cases if case.knee.grade == 4]
    built = pssf.build(case.knee, case.exposures[0].protocol)
    assert (built.bones["femur"].outer ^ built.bones["tibia"].outer).volume() <= ROUNDING_MM3
