"""Check the built knee: closed solids, joint space widths, osteophytes, subchondral bone plates and soft tissue."""

import dataclasses

import numpy as np
import pytest
import trimesh
from conftest import build_once
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy.bones import bone_shells
from pssf.anatomy.meshing import implicit_shapes, remesh
from pssf.anatomy.meshing.solids import (
    build_height_field,
    build_solid,
    extract_mesh,
    find_closed_mesh_edges,
    find_edges,
    loft,
    make_ring,
    require_valid_solid,
    split_edges,
)
from pssf.anatomy.posture.knee_assembly import load_jsw_protocol
from pssf.anatomy.soft_tissue import cartilage_and_menisci
from pssf.anatomy.template.bone_builder import deform_template_points, resolve_bone_parameters
from pssf.anatomy.template.template_femur import make_template_femur
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.model.knee import CENTRAL_SITES, MARGIN_AND_SPINE_SITES, OSTEOPHYTE_SITES
from pssf.validation.knees import morphometry

REFERENCE = pssf.load_protocol("reference")
TABLES = load_anatomy_tables()
SHAPE = TABLES.template
MEAN = resolve_bone_parameters(pssf.Knee(), TABLES)


@pytest.fixture(scope="module")
def shells_mm():
    """Return the cortex depths of the femur and the tibia of the template anatomy."""
    return bone_shells.compute_cortex_depths_mm(MEAN)


@pytest.fixture(scope="module")
def bones_without_osteophytes(shells_mm):
    """Return the grown and the built femur and tibia of the template anatomy without osteophytes."""
    femur, tibia = bone_shells.grow_femur_osteophytes(MEAN, ()), bone_shells.grow_tibia_osteophytes(MEAN, ())
    made = bone_shells.build_femur(MEAN, femur, shells_mm[0]), bone_shells.build_tibia(MEAN, tibia, shells_mm[1])
    return {"femur": (femur, made[0]), "tibia": (tibia, made[1])}


def test_a_loft_between_equal_rings_has_the_volume_of_a_prism():
    rings = np.array([make_ring(3.0, 3.0, (0.0, 0.0, z), 2.0, 64) for z in (0.0, 2.0, 5.0)])
    area = 0.5 * 64 * 9.0 * np.sin(2 * np.pi / 64)
    assert_allclose(loft(rings, "prism").volume(), 5.0 * area, rtol=1e-12)


def test_a_height_field_has_the_volume_below_its_surface():
    x, y = np.linspace(0, 2, 5), np.linspace(0, 3, 7)
    tops = np.add.outer(x, 2 * y) + 4.0
    assert_allclose(build_height_field(x, y, tops, 1.0, "ramp").volume(), 6.0 * (1.0 + 3.0 + 3.0), rtol=1e-12)


def test_an_empty_solid_is_rejected_with_its_status_and_volume():
    with pytest.raises(pssf.InputError, match=r"solid nothing must have .*, got status NoError and volume 0 mm3"):
        require_valid_solid(Manifold(), "nothing")


@given(seed=st.integers(0, 2**32), grade=st.sampled_from([0, 1, 2]))
@settings(max_examples=4)
def test_every_sampled_knee_is_watertight_and_has_the_specified_jsw(seed, grade):
    knee = pssf.sample_knee(grade=grade, rng=np.random.default_rng(seed), grade_table="paper")
    built = pssf.build(knee)
    assert_allclose(built.measure_jsw_mm(REFERENCE), [knee.jsw_medial_mm, knee.jsw_lateral_mm], atol=0.01)
    for surface in built.scene.surfaces:
        assert surface.mesh.is_watertight
        assert surface.mesh.volume > 0


@pytest.mark.parametrize(
    "corner",
    [(1400.0, 0.85, 90.0, 2.0, -16.0, -10.0, -2.0), (2100.0, 1.15, 180.0, 30.0, 16.0, 10.0, 18.0)],
)
def test_knees_at_the_limits_of_the_parameter_ranges_can_be_built(corner):
    stature, scale, limb, fat, varus, rotation, slope = corner
    knee = pssf.Knee(
        stature_mm=stature, bone_scale=scale, limb_ap_mm=limb, fat_mm=fat, varus_deg=varus, rotation_deg=rotation,
        flexion_deg=15.0, tibial_slope_deg=slope, jsw_medial_mm=2.5, jsw_lateral_mm=5.5, subchondral_plate=1.6,
        osteophytes=tuple(pssf.Osteophyte(site=site, size_mm=3.0) for site in OSTEOPHYTE_SITES),
    )  # fmt: skip
    assert_allclose(pssf.build(knee).measure_jsw_mm(REFERENCE), [2.5, 5.5], atol=0.01)


def test_jsw_is_as_specified_if_levelling_moves_the_landmarks():
    shape = (-0.5514, 1.7933, 0.8158, -0.8964, 1.297, -0.7099, -1.356, -1.4932, 0.8587, 0.9509, -0.5973, 1.4226, 1.1711)
    knee = pssf.Knee(
        side="right", sex="female", stature_mm=1554.93, jsw_medial_mm=3.1801, jsw_lateral_mm=5.2881,
        jsw_definition="read",
        shape=shape, bone_scale=1.01, varus_deg=1.1735, flexion_deg=1.4828, rotation_deg=1.9911, lean_deg=4.4212,
        tibial_slope_deg=4.6709, notch_growth_mm=0.4442,
    )  # fmt: skip
    jsw_protocol = load_jsw_protocol(knee)
    assert_allclose(pssf.build(knee, jsw_protocol).measure_jsw_mm(jsw_protocol), [3.1801, 5.2881], atol=1e-3)


def test_jsw_is_as_specified_with_a_spine_osteophyte_in_a_narrow_notch():
    shape = (3.0, -3.0, -3.0, -3.0, 3.0, 3.0, -3.0, 3.0, 3.0, -3.0, -3.0, 3.0, -3.0)
    knee = pssf.Knee(
        side="right", sex="female", stature_mm=1949.0, jsw_medial_mm=5.472, jsw_lateral_mm=4.555, shape=shape,
        osteophytes=(pssf.Osteophyte(site="medial_spine", size_mm=2.9),), bone_scale=1.095, varus_deg=4.43,
        flexion_deg=2.04, rotation_deg=-1.91, lean_deg=-2.35, tibial_slope_deg=1.7,
    )  # fmt: skip
    assert_allclose(pssf.build(knee).measure_jsw_mm(REFERENCE), [5.472, 4.555], atol=1e-3)


@pytest.mark.parametrize(("varus", "spaces"), [(14.0, (0.0, 10.0)), (-14.0, (10.0, 0.0))])
def test_a_knee_with_one_closed_and_one_wide_joint_space_can_be_built(varus, spaces):
    knee = pssf.Knee(jsw_medial_mm=spaces[0], jsw_lateral_mm=spaces[1], varus_deg=varus, grade=4)
    coarse = dataclasses.replace(pssf.load_protocol("fixed_flexion"), rows=128, cols=128, pixel_mm=2.4)
    # `trace` raises InputError for negative path lengths.
    angle_deg = pssf.simulate(knee, coarse, engine="scanline").truth.readings["femorotibial_deg"]
    assert angle_deg == 175.0 + varus
    assert_allclose(pssf.build(knee).measure_jsw_mm(REFERENCE), spaces, atol=1e-3)


@pytest.mark.parametrize(
    ("spaces", "posture"),
    [
        *(((0.0, 5.5), None), ((6.0, 0.0), None), ((0.0, 0.0), None), ((0.03, 4.0), None)),
        *(((0.0, 0.0), "fixed_flexion"), ((0.03, 4.0), "fixed_flexion")),
    ],
)
def test_bones_in_contact_do_not_overlap(spaces, posture):
    knee = pssf.Knee(jsw_medial_mm=spaces[0], jsw_lateral_mm=spaces[1], subchondral_plate=1.8)
    built = pssf.build(knee, pssf.load_protocol(posture) if posture else None)
    if posture is None:
        assert_allclose(built.measure_jsw_mm(REFERENCE), spaces, atol=1e-3)
    assert (built.bones["femur"].outer ^ built.bones["tibia"].outer).volume() < 1e-6
    assert str(pssf.check(built.scene)) == "no faults"


def test_bones_that_would_overlap_are_rejected(knee, built, monkeypatch):
    pose = built.assembly.pose
    sunk = dataclasses.replace(built.assembly, pose=dataclasses.replace(pose, raise_mm=pose.raise_mm - 12.0))
    monkeypatch.setattr("pssf.anatomy.built_knee.pose_knee", lambda *_: sunk)
    with pytest.raises(pssf.InputError, match=r"femur and tibia overlap by more than 7 mm, .* mm3"):
        pssf.build(knee)


def test_a_left_knee_is_the_mirror_image_of_a_right_one(knee, scene):
    mirrored = build_once(dataclasses.replace(knee, side="left")).scene
    for right, left in zip(scene.surfaces, mirrored.surfaces, strict=True):
        assert_allclose(left.mesh.vertices * [-1, 1, 1], right.mesh.vertices, atol=1e-12)
        assert_allclose(left.mesh.volume, right.mesh.volume, rtol=1e-9)


def test_landmarks_of_a_left_knee_mirror_those_of_a_right_one(knee, built):
    left = dataclasses.replace(knee, side="left")
    right_px = built.truth(REFERENCE).medial_joint_line_px
    left_px = build_once(left).truth(REFERENCE).medial_joint_line_px
    assert left_px[1] == pytest.approx(REFERENCE.cols - 1 - right_px[1], abs=1e-6)
    assert left_px[0] == pytest.approx(right_px[0], abs=1e-6)


def test_the_joint_line_is_at_the_origin(built):
    row, _ = built.truth(REFERENCE).landmarks_px["joint_centre"]
    assert row == pytest.approx((REFERENCE.rows - 1) / 2, abs=0.5)


@pytest.mark.parametrize("site", MARGIN_AND_SPINE_SITES)
@pytest.mark.parametrize("size", [0.3, 1.0, 3.0, 6.0])
def test_an_osteophyte_protrudes_by_its_size(site, size, shells_mm, bones_without_osteophytes):
    side, where = site.split("_")
    make, grow = (
        (bone_shells.build_femur, bone_shells.grow_femur_osteophytes)
        if where == "femur"
        else (bone_shells.build_tibia, bone_shells.grow_tibia_osteophytes)
    )
    shell_mm = shells_mm[0 if where == "femur" else 1]
    form = MEAN.femur if where == "femur" else MEAN.tibia
    osteophyte = pssf.Osteophyte(site=site, size_mm=size)
    (before, plain), after = (
        bones_without_osteophytes["femur" if where == "femur" else "tibia"],
        grow(MEAN, (osteophyte,)),
    )
    reach = []
    for bone in (before, after):
        points = extract_mesh(bone.outer).vertices
        points = points[points[:, 0] * (1 if side == "medial" else -1) > 1]
        low, high = (3.0, 10.0) if where == "femur" else (-7.0, 12.0)
        joint = points[(points[:, 2] > low) & (points[:, 2] < high)]
        reach.append(
            deform_template_points(points, form)[:, 2].max()
            if where == "spine"
            else abs(deform_template_points(joint, form)[:, 0]).max()
        )
    assert reach[1] - reach[0] == pytest.approx(size, abs=0.1)
    made = make(MEAN, after, shell_mm)
    assert made.outer.volume() > plain.outer.volume()
    assert (made.inner - made.outer).volume() == 0


@pytest.mark.parametrize("site", CENTRAL_SITES)
@pytest.mark.parametrize(("size", "place"), [(0.3, 0.0), (1.0, -1.0), (2.5, 0.5), (5.0, 1.0)])
def test_a_central_osteophyte_rises_from_the_joint_surface_by_its_size(
    site, size, place, shells_mm, bones_without_osteophytes
):
    osteophyte = pssf.Osteophyte(site=site, size_mm=size, place=place)
    make, grow, form = (
        (bone_shells.build_femur, bone_shells.grow_femur_osteophytes, MEAN.femur)
        if osteophyte.bone == "femur"
        else (bone_shells.build_tibia, bone_shells.grow_tibia_osteophytes, MEAN.tibia)
    )
    (before, plain), grown = bones_without_osteophytes[osteophyte.bone], grow(MEAN, (osteophyte,))
    table = MEAN.shape.osteophytes.central
    points = extract_mesh(before.outer).vertices
    about = points[
        abs(points[:, 0] - (1 if site.startswith("medial") else -1) * table.across_mm) < table.base_half_width_mm
    ]
    if osteophyte.bone == "femur":
        angle = np.deg2rad(np.interp(place, (-1, 1), table.femur_deg))
        direction = np.array([0, np.sin(angle), -np.cos(angle)])
    else:
        direction = np.array([0.0, 0.0, 1.0])
        about = about[abs(about[:, 1] - np.interp(place, (-1, 1), table.tibia_mm)) < table.base_half_width_mm]
    (mound,) = grown.shapes
    tip = mound.farthest_point[None]
    assert (deform_template_points(tip, form) @ direction)[0] - (
        deform_template_points(about, form) @ direction
    ).max() == pytest.approx(size, abs=1e-8)
    assert np.linalg.norm(extract_mesh(grown.outer).vertices - tip, axis=1).min() < 1e-4
    shell_mm = shells_mm[0 if osteophyte.bone == "femur" else 1]
    bone = make(MEAN, grown, shell_mm)
    assert bone.outer.volume() > plain.outer.volume()
    assert (bone.inner - bone.outer).volume() == 0


def test_a_thicker_subchondral_bone_plate_replaces_trabecular_bone():
    thick = dataclasses.replace(MEAN, plates=dataclasses.replace(MEAN.plates, medial=1.5, lateral=1.5))
    normal, sclerotic = (
        bone_shells.build_tibia(
            build, bone_shells.grow_tibia_osteophytes(build, ()), bone_shells.compute_cortex_depths_mm(build)[1]
        )
        for build in (MEAN, thick)
    )
    assert sclerotic.inner.volume() < normal.inner.volume()
    assert_allclose(sclerotic.outer.volume(), normal.outer.volume(), rtol=1e-12)


@pytest.mark.parametrize(("spaces", "side_sign"), [((5.0, 5.0), 1), ((4.5, 4.0), 1), ((2.0, 5.0), 1), ((5.0, 2.0), -1)])
def test_sclerosis_is_greater_in_the_narrower_compartment(spaces, side_sign):
    knee = pssf.Knee(jsw_medial_mm=spaces[0], jsw_lateral_mm=spaces[1], subchondral_plate=1.5)
    plates, healthy = resolve_bone_parameters(knee, TABLES).plates, resolve_bone_parameters(pssf.Knee(), TABLES).plates
    far = (
        plates.interpolate(np.array([[side_sign * 400.0, 0.0, 0.0], [side_sign * -400.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
        / healthy.medial
    )
    fraction = TABLES.trabecular_bone.sclerosis.other_side
    assert 0 < fraction < 1
    assert_allclose(far, [1.5, 1 + 0.5 * fraction, 1 + 0.25 * (1 + fraction)], atol=1e-3)
    assert healthy.medial == healthy.lateral


@pytest.mark.parametrize(("varus", "medial"), [(-5.0, 2.5), (0.0, 5.0), (5.0, 2.5), (5.0, 5.0)])
def test_the_angle_between_the_shafts_equals_varus_for_any_jsw(varus, medial):
    sizes = morphometry.measure_knee_sizes(pssf.Knee(varus_deg=varus, jsw_medial_mm=medial))
    assert abs(sizes["error of varus_deg"]) < 0.1


@given(data=st.data())
def test_splitting_edges_keeps_the_mesh_closed_and_its_volume(data):
    box = trimesh.creation.box((2.0, 3.0, 5.0))
    edges = find_edges(box.faces)
    selected = edges[data.draw(st.lists(st.integers(0, len(edges) - 1), min_size=1, unique=True))]
    points = np.vstack((box.vertices, box.vertices[selected].mean(axis=1)))
    mesh = trimesh.Trimesh(points, split_edges(np.asarray(box.faces), selected, len(box.vertices)), process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert len(mesh.faces) == len(box.faces) + 2 * len(selected)
    assert_allclose(mesh.volume, 30.0, rtol=1e-12)


def test_distances_to_triangles_agree_with_trimesh():
    rng = np.random.default_rng(3)
    triangles, point = rng.normal(size=(2000, 3, 3)), rng.normal(size=3)
    nearest = trimesh.triangles.closest_point(triangles, np.repeat(point[None], len(triangles), axis=0))
    assert_allclose(
        remesh._compute_triangle_distances_mm(triangles, point), np.linalg.norm(nearest - point, axis=1), atol=1e-12
    )


def test_each_edge_of_a_closed_mesh_is_found_once():
    faces = extract_mesh(Manifold.sphere(3.0, 24) - Manifold.cube((1.0, 1.0, 9.0), True)).faces
    found = find_closed_mesh_edges(faces)
    assert len(np.unique(found, axis=0)) == len(found)
    np.testing.assert_array_equal(found[np.lexsort(found.T[::-1])], find_edges(faces))


def test_refinement_keeps_every_edge_within_tolerance_of_the_surface():
    def ball(points):
        return np.linalg.norm(points, axis=1) - 20.0

    coarse = implicit_shapes.project_solid(Manifold.sphere(20.0, 16), ball)
    fine = remesh.refine_to_tolerance(coarse, ball, 0.05, 6)
    mesh = extract_mesh(fine)
    assert np.abs(ball(mesh.vertices[find_edges(mesh.faces)].mean(axis=1))).max() < 0.06
    assert np.abs(ball(mesh.vertices)).max() < 1e-6


def test_soft_tissues_overlap_neither_bones_nor_each_other(scene):
    solids = {s.name: build_solid(np.array(s.mesh.vertices), np.array(s.mesh.faces), s.name) for s in scene.surfaces}
    soft = [s.name for s in scene.surfaces if s.outside == "muscle" and s.inside != "cortical_bone"]
    cartilage_like = {"femur_cartilage", "tibia_cartilage", "patella_cartilage", "medial_meniscus", "lateral_meniscus"}
    assert set(soft) == cartilage_like | {"fat_pad", "patellar_tendon", "quadriceps_tendon", "intermuscular_fat"}
    for number, name in enumerate(soft):
        assert solids[name].volume() > 100
        assert (solids[name] - solids["muscle"]).volume() < 1e-3
        for other in (*soft[number + 1 :], "femur", "tibia", "fibula", "patella"):
            assert (solids[name] ^ solids[other]).volume() < 0.05, (name, other)


def test_femoral_cartilage_fills_47_percent_of_the_joint_space():
    for space in (2.0, 6.0):
        layer = cartilage_and_menisci.build_femoral_cartilage(
            extract_mesh(make_template_femur(SHAPE.femur, TABLES.shape_model).outer), SHAPE, 1.0, (space, space)
        )
        thick = np.linalg.norm(layer.top - layer.bone, axis=1)
        assert thick.max() == pytest.approx(0.47 * space, rel=1e-9)
        assert (thick[layer.bone[:, 2] > 60] == 0).all()


def test_cartilage_does_not_overlap_a_marginal_osteophyte():
    osteophytes = tuple(
        pssf.Osteophyte(site=site, size_mm=size)
        for site, size in (("lateral_tibia", 2.7548), ("lateral_spine", 1.2385), ("medial_tibia", 1.6925))
    )
    knee = pssf.Knee(jsw_medial_mm=2.8925, jsw_lateral_mm=4.6688, bone_scale=0.9353, osteophytes=osteophytes)
    layers = [s for s in pssf.build(knee).scene.surfaces if s.name.endswith("_cartilage")]
    assert len(layers) == 3
    for layer in layers:
        faults = pssf.check(pssf.Scene([layer], "muscle")).faults
        assert [fault.surface for fault in faults] == ["ambient"]  # the scene contains no muscle around the layer
