"""Check soft tissue: muscles, intermuscular fat and limb thickness by BMI."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy.meshing.bounding_solid import build_envelope
from pssf.anatomy.meshing.solids import build_solid
from pssf.geometry.mesh import Mesh
from pssf.geometry.view import project_points, resolve_view
from pssf.validation.knees.build_success import sample_wide_range_knee

SMALL = dict(rows=192, cols=192, pixel_mm=1.6, texture="none")
REFERENCE = dataclasses.replace(pssf.load_protocol("reference"), **SMALL)
FIXED_FLEXION = dataclasses.replace(pssf.load_protocol("fixed_flexion"), **SMALL)


def build_solids(scene: pssf.Scene) -> dict:
    return {s.name: build_solid(*s.mesh_arrays, s.name) for s in scene.surfaces}


def measure_path_at(paths: pssf.Paths, material: str, position_mm: tuple[float, float, float]) -> float:
    row, col = np.rint(project_points(np.array([position_mm]), resolve_view(REFERENCE))[0]).astype(int)
    return float(paths.path_mm[material][row, col])


@pytest.mark.parametrize(
    ("side", "bmi", "flexion_deg", "score"),
    [
        ("right", 15.0, 0.0, -3.0),
        ("left", 50.0, 0.0, 3.0),
        ("left", 15.0, 20.0, 0.0),
        ("right", 50.0, 40.0, 1.0),
    ],
)
def test_intermuscular_fat_overlaps_no_other_tissue(side, bmi, flexion_deg, score):
    scores = tuple(score * sign for sign in (1, -1, 1, 1, -1, 1, -1, -1, 1, 1, -1, 1, -1))
    knee = pssf.sample_knee(
        grade=0, rng=np.random.default_rng(4), side=side, bmi=bmi, shape=scores, grade_table="paper"
    )
    protocol = dataclasses.replace(FIXED_FLEXION, flexion_deg=flexion_deg)
    scene = pssf.build(knee, protocol).scene
    solids = build_solids(scene)
    fat = solids["intermuscular_fat"]
    assert 0.1 < fat.volume() / solids["muscle"].volume() < 0.4
    assert (fat - solids["muscle"]).volume() < 1e-6
    others = [s.name for s in scene.surfaces if s.outside == "muscle" and s.name != "intermuscular_fat"]
    assert max((fat ^ solids[name]).volume() for name in others) < 1e-6
    report = str(pssf.check(scene))
    assert not any(name in report for name in ("intermuscular_fat", "quadriceps_tendon", "muscle:"))

    paths = pssf.trace(scene, protocol, engine="scanline", precision="float64").path_mm
    skin = pssf.Scene([s for s in scene.surfaces if s.name == "skin"])
    whole = pssf.trace(skin, protocol, engine="scanline", precision="float64").path_mm["skin"]
    assert min(path.min() for path in paths.values()) > -1e-9
    assert_allclose(sum(path for name, path in paths.items() if name != "air"), whole, atol=1e-9)


def test_tissue_is_mostly_fat_beside_the_tibia_and_muscle_in_the_thigh(built, scene):
    paths = pssf.trace(scene, REFERENCE, engine="scanline")
    edge = built.assembly.bone_parameters.half_ml_mm
    beside, thigh = (edge + 4.0, 0.0, -20.0), (edge - 6.0, 0.0, 110.0)
    assert measure_path_at(paths, "adipose", beside) > 1.2 * measure_path_at(paths, "muscle", beside)
    assert measure_path_at(paths, "muscle", thigh) > 2.0 * measure_path_at(paths, "adipose", thigh)


def test_fat_fills_the_popliteal_fossa_and_lies_behind_the_tendon(scene):
    solids = build_solids(scene)
    fat = solids["intermuscular_fat"]
    fossa = trimesh.creation.box((16.0, 10.0, 10.0)).apply_translation((-12.0, 40.0, 60.0))
    block = build_solid(fossa.vertices, fossa.faces, "fossa")
    assert (fat ^ block).volume() > 0.6 * block.volume()
    tendon = solids["quadriceps_tendon"]
    behind = tendon.translate((0.0, 9.0, 0.0)) - solids["femur"]
    assert (fat ^ behind).volume() > 0.1 * behind.volume()
    assert (tendon - solids["muscle"]).volume() < 1e-6


def test_the_thigh_encloses_a_long_femur():
    rng = np.random.default_rng(np.random.SeedSequence(1936, spawn_key=(1,)))
    solids = build_solids(pssf.build(sample_wide_range_knee(rng, 13)).scene)
    assert (solids["femur"] - solids["muscle"]).volume() < 1e-6


@given(seed=st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_an_envelope_contains_its_solids_with_a_margin(seed):
    rng = np.random.default_rng(seed)
    meshes = []
    for _ in range(2):
        ball = trimesh.creation.icosphere(3)
        points = ball.vertices * (1 + 0.3 * np.sin(ball.vertices @ rng.normal(0, 2, (3, 3))).sum(axis=1, keepdims=True))
        points = points * rng.uniform(5, 40, 3) + rng.normal(0, 10, 3)
        meshes.append(Mesh(points, np.asarray(ball.faces, dtype=np.int64)))
    around = build_envelope(meshes, ((-50.0, 1.0), (50.0, 2.0)), "around", 200.0)
    for mesh in meshes:
        solid = build_solid(mesh.vertices, mesh.faces, "inner")
        assert (solid - around).volume() < 1e-9
        for x, y in ((0.9, 0.0), (0.0, -0.9), (0.6, 0.6)):
            assert (solid.translate((x, y, 0.0)) - around).volume() < 1e-9


def test_a_higher_bmi_gives_a_thicker_limb_with_more_fat():
    light, mean, heavy = (pssf.Knee(bmi=bmi) for bmi in (18.0, 28.6, 45.0))
    assert light.limb_ap_mm < mean.limb_ap_mm == 122.0 < heavy.limb_ap_mm
    assert light.fat_mm < mean.fat_mm == 10.0 < heavy.fat_mm
    widths = [np.ptp(pssf.build(knee).scene.surfaces[0].mesh_arrays.vertices, axis=0) for knee in (light, heavy)]
    assert (widths[1][:2] - widths[0][:2] > 20.0).all()
