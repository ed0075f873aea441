"""Check implicit shapes and the meshes that are projected onto them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import pssf
from pssf import anatomy, raycast
from pssf.anatomy.bones import bone_shells
from pssf.anatomy.meshing import implicit_shapes, remesh
from pssf.anatomy.meshing.solids import build_solid, extract_mesh
from pssf.anatomy.template import template_femur
from pssf.anatomy.template.bone_builder import resolve_bone_parameters
from pssf.anatomy.template.template_bone import SubchondralPlates
from pssf.anatomy.template.template_femur import make_template_femur
from pssf.anatomy.template.template_tibia import make_template_tibia
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.model.knee import (
    CENTRAL_SITES,
    MARGIN_AND_SPINE_SITES,
    OSTEOPHYTE_SITES,
    Osteophyte,
)
from pssf.patient_comparison.bones.surface_distance import sample_surface
from pssf.validation.knees.build_success import sample_wide_range_knee

TABLES = load_anatomy_tables()
SHAPE = TABLES.template
BONES = [make_template_femur(SHAPE.femur, TABLES.shape_model), make_template_tibia(SHAPE.tibia, TABLES.shape_model)]


@given(x=st.floats(-25, 25), y=st.floats(-18, 18))
def test_the_field_of_a_column_varies_smoothly_from_side_to_axis(x, y):
    # The depth must be the relative distance to the side times a length between smaller and larger half-width.
    shaft = implicit_shapes.ColumnField(np.array([[-10.0, 30.0, 20.0, 0.0, 0.0], [10.0, 30.0, 20.0, 0.0, 0.0]]), 2.3)
    norm = ((abs(x) / 30) ** 2.3 + (abs(y) / 20) ** 2.3) ** (1 / 2.3)
    value = shaft(np.array([[x, y, 0.0]]))[0]
    low, high = sorted(((norm - 1) * 20 * 0.8, (norm - 1) * 30 * 1.1))
    assert low - 1e-9 <= value <= high + 1e-9


def test_the_depth_on_a_column_axis_equals_the_smaller_half_width():
    shaft = implicit_shapes.ColumnField(np.array([[-10.0, 30.0, 20.0, 1.0, 2.0], [10.0, 30.0, 20.0, 1.0, 2.0]]), 2.3)
    assert_allclose(shaft(np.array([[2.0, 1.0, 0.0]])), -20.0)


def compute_outward_cosines(solid, field) -> np.ndarray:
    """Return the cosine of triangle normals and field gradient, except at the cut ends of shafts."""
    mesh = extract_mesh(solid).as_trimesh()
    middle = np.asarray(mesh.triangles_center)
    _, slope = implicit_shapes.evaluate_with_gradient(field, middle)
    cosine = (np.asarray(mesh.face_normals) * slope).sum(axis=1) / np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
    return cosine[(np.abs(middle[:, 2]) < 190.0) & (np.asarray(mesh.area_faces) > 1e-9)]


@pytest.mark.parametrize("bone", BONES, ids=["femur", "tibia"])
def test_every_triangle_of_a_bone_faces_outwards(bone):
    assert compute_outward_cosines(bone.outer, bone.field).min() > 0


@pytest.mark.parametrize("bone", BONES, ids=["femur", "tibia"])
@pytest.mark.parametrize(("cortex", "plate"), [(1.0, 1.0), (0.6, 0.4), (1.5, 2.5)])
def test_the_marrow_depth_equals_cortex_and_subchondral_plate(bone, cortex, plate):
    points = bone.build_inner_mesh(bone.compute_depth_mm(cortex, SubchondralPlates(plate, plate, 10.0))).vertices
    points = points[np.abs(points[:, 2]) < 190.0]
    deviations = np.abs(bone.field(points) + bone.shell_thickness_mm(points, cortex, plate))
    assert np.quantile(deviations, 0.999) < 0.1
    assert deviations.max() < 0.3


@pytest.mark.parametrize("number", [*(pytest.param(number, marks=pytest.mark.slow) for number in range(3)), 3])
def test_a_knee_with_many_osteophytes_has_no_negative_path_length(number):
    rng = np.random.default_rng(number)
    sites = rng.permutation(OSTEOPHYTE_SITES)[: 2 + number]
    osteophytes = tuple(pssf.Osteophyte(site=str(site), size_mm=float(rng.uniform(0.3, 3.0))) for site in sites)
    knee = pssf.Knee(jsw_medial_mm=2.8, osteophytes=osteophytes, flexion_deg=3.0 * number, rotation_deg=-2.0 * number)
    scene = anatomy.build(knee).scene
    for name in ("reference", "geometry_shift"):
        protocol = pssf.load_protocol(name)
        paths = raycast.trace(scene, protocol, engine="scanline", precision="float64", texture=False)
        for material, lengths in paths.path_mm.items():
            assert lengths.min() > -1e-6, material


@pytest.fixture
def inward_face_counts(monkeypatch):
    """Record the number of inward-facing movable triangles per bone before and after their correction."""
    counts, fix = [], remesh._fix_inverted_faces

    def fix_and_count(points, faces, free, field, moved=None):
        def count_inward(points, faces):
            moved = faces[free[faces].any(axis=1) & (np.abs(points[faces, 2]) < 200).all(axis=1)]
            return int(remesh._is_facing_inwards(points[moved], field).sum())

        fixed = fix(points, faces, free, field, moved)
        counts.append((count_inward(points, faces), count_inward(*fixed)))
        return fixed

    monkeypatch.setattr(remesh, "_fix_inverted_faces", fix_and_count)
    return counts


def grow_osteophytes(knee):
    """Grow the osteophytes of femur and tibia without building the knee."""
    form = resolve_bone_parameters(knee, TABLES)
    for grown in (
        bone_shells.grow_femur_osteophytes(form, knee.osteophytes),
        bone_shells.grow_tibia_osteophytes(form, knee.osteophytes),
    ):
        assert grown.outer.volume() > 0


@pytest.mark.parametrize("number", range(6))
def test_every_triangle_of_an_osteophyte_faces_outwards(number, inward_face_counts):
    rng = np.random.default_rng(number)
    osteophytes = [
        pssf.Osteophyte(site=str(site), size_mm=float(rng.uniform(0.3, 3.0))) for site in MARGIN_AND_SPINE_SITES
    ]
    grow_osteophytes(
        pssf.Knee(jsw_medial_mm=2.8, osteophytes=tuple(osteophytes), bone_scale=float(rng.uniform(0.9, 1.1)))
    )
    assert inward_face_counts
    assert sum(before for before, _ in inward_face_counts) > 0
    assert sum(after for _, after in inward_face_counts) == 0


@pytest.mark.parametrize("number", range(4))
def test_every_triangle_of_a_central_osteophyte_faces_outwards(number, inward_face_counts):
    rng = np.random.default_rng(number)
    mounds = [
        pssf.Osteophyte(site=site, size_mm=float(rng.uniform(0.3, 5.0)), place=float(rng.uniform(-1, 1)))
        for site in CENTRAL_SITES
    ]
    grow_osteophytes(pssf.Knee(osteophytes=tuple(mounds), shape=tuple(rng.uniform(-2, 2, 13))))
    assert inward_face_counts
    assert sum(after for _, after in inward_face_counts) == 0


# In an earlier version, the correction of folds removed 0.24 mm of an osteophyte tip of 0.55 mm.
KNEE_WITH_SHARP_OSTEOPHYTES = pssf.Knee(
    sex="female",
    stature_mm=1873.402215822025,
    jsw_medial_mm=3.7184909714917986,
    jsw_lateral_mm=4.296065338046113,
    osteophytes=(
        pssf.Osteophyte(site="lateral_tibia", size_mm=0.668378088386997),
        pssf.Osteophyte(site="medial_femur", size_mm=2.5471914485679474),
        pssf.Osteophyte(site="medial_spine", size_mm=0.680600844952032),
        pssf.Osteophyte(site="lateral_femur", size_mm=1.3956546683087803),
        pssf.Osteophyte(site="lateral_spine", size_mm=2.143589357446249),
        pssf.Osteophyte(site="medial_tibia", size_mm=0.3402309620650099),
    ),
    subchondral_plate=1.5325370245089738,
    varus_deg=-4.183954056250519,
    flexion_deg=13.015230920961052,
    rotation_deg=-8.760602343129273,
    bone_scale=1.072015125419122,
    cortex_scale=1.2719909885422809,
    tibial_slope_deg=4.932338652828216,
    limb_ap_mm=153.00877190950138,
    fat_mm=8.223692340851724,
)


def test_no_osteophyte_tip_is_cut_off():
    assembly = anatomy.build(KNEE_WITH_SHARP_OSTEOPHYTES).assembly
    shapes = [(grown.outer, shape) for grown in (assembly.femur, assembly.tibia) for shape in grown.shapes]
    assert len(shapes) == 6
    for outer, shape in shapes:
        points = extract_mesh(outer).vertices
        about = points[np.linalg.norm(points - shape.tip, axis=1) < 3.0]
        assert (about @ shape.direction).max() == pytest.approx(shape.farthest_point @ shape.direction, abs=1e-4)


def test_folds_of_a_mesh_are_smoothed():
    # Three vertices of a fine condyle mesh are moved across their neighbours, which causes folds.
    ball = template_femur._build_csg_condyle(SHAPE.femur.condyles.medial, "medial").refine_to_length(2.0)

    def field(points):
        return template_femur.condyle_distance_mm(points, SHAPE.femur.condyles.medial)

    def pull(points):
        points = np.array(points)
        for at in (100, 900, 1300):
            points[at] = points[at] + 1.2 * (
                points[np.argsort(((points - points[at]) ** 2).sum(axis=1))[8]] - points[at]
            )
        return points

    settled = implicit_shapes.project_solid(ball, field).warp_batch(pull)
    assert compute_outward_cosines(settled, field).min() < 0
    assert (
        compute_outward_cosines(
            build_solid(*remesh.laplacian_smooth(extract_mesh(settled), field, 0), "smoothed"), field
        ).min()
        > 0
    )


# The canal ends in a crescent, 25 mm wide and 0.8 mm thick, which does not contain its own centre.
KNEE_WITH_CRESCENT_CANAL = pssf.Knee(
    sex="female", stature_mm=1975.582, jsw_medial_mm=4.4926, jsw_lateral_mm=4.1687, varus_deg=-1.9591,
    flexion_deg=9.152, rotation_deg=4.3046, bone_scale=0.9016, cortex_scale=1.1217, tibial_slope_deg=11.1946,
    lean_deg=-10.2243, shape=(-3, 3, 3, 3, -3, 3, 3, -3, -3, -3, -3, -3, -3),
)  # fmt: skip


def test_a_medullary_canal_with_a_crescent_tip_does_not_fold():
    mesh = extract_mesh(anatomy.build(KNEE_WITH_CRESCENT_CANAL).bones["femur"].canal)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    tip = corners[:, :, 2].max(axis=1) < mesh.vertices[:, 2].min() + 1.5
    assert tip.sum() > 20
    assert (normals[tip, 2] < 0).all()


@pytest.mark.parametrize(
    "number", [1416, *(pytest.param(number, marks=pytest.mark.slow) for number in (1462, 1536, 1542))]
)
def test_the_trabecular_bone_of_knees_with_osteophytes_is_one_piece(number):
    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(1,)))
    built = anatomy.build(sample_wide_range_knee(rng, 13))
    assert {name: len(bone.inner.decompose()) for name, bone in built.bones.items() if name in ("femur", "tibia")} == {
        "femur": 1,
        "tibia": 1,
    }


def test_a_spine_osteophyte_does_not_raise_the_tibial_margin():
    rng = np.random.default_rng(np.random.SeedSequence(260, spawn_key=(1,)))
    bare = replace(sample_wide_range_knee(rng, 13), osteophytes=(), side="right", rotation_deg=0.0)
    grown = replace(bare, osteophytes=(Osteophyte(site="lateral_spine", size_mm=2.0),))
    before, after = (extract_mesh(anatomy.build(knee).bones["tibia"].outer) for knee in (bare, grown))
    nearest = sample_surface(before).find_nearest(after.vertices)[0]
    raised = after.vertices[np.linalg.norm(after.vertices - nearest, axis=1) > 1.0]
    assert len(raised) > 10
    assert (np.abs(raised[:, 0]) < 20.0).all()
