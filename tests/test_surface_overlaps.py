"""Check the comparison of stated surface materials with materials along rays."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from test_raycast import make_ball, make_box, make_protocol, move_mesh

from pssf import Scene, Surface
from pssf.geometry.view import View, resolve_view
from pssf.raycast.surface_overlaps import find_contradictions, find_self_overlaps

VIEW = resolve_view(make_protocol(rows=64, cols=64, pixel_mm=3.0))
positions = st.tuples(*3 * [st.floats(-8, 8)])


def build_limb_scene(*surfaces):
    return Scene([Surface(make_ball(70.0), "muscle", "air", "limb"), *surfaces])


def list_contradictions(scene, view=VIEW):
    return {
        (one.surface, one.stated_material, one.found_material, one.found_surface)
        for one in find_contradictions(scene, view)
    }


@settings(max_examples=15)
@given(at=positions, turn=st.tuples(*3 * [st.floats(-180, 180)]), order=st.permutations(range(3)))
def test_nested_shells_have_no_contradictions_in_any_pose_or_order(at, turn, order):
    shells = [
        Surface(move_mesh(make_box(50, 40, 60), at, turn), "cortical_bone", "muscle", "bone"),
        Surface(move_mesh(make_box(40, 30, 50), at, turn), "trabecular_bone", "cortical_bone", "trabecular"),
        Surface(
            move_mesh(make_box(20, 10, 50), at, turn), "marrow", "trabecular_bone", "marrow"
        ),  # the ends coincide with the wall of the trabecular surface
    ]
    assert not find_contradictions(build_limb_scene(*(shells[k] for k in order)), VIEW)


@pytest.mark.parametrize(
    ("inside", "outside", "expected"),
    [
        ("marrow", "muscle", {("core", "muscle", "cortical_bone", "bone")}),
        ("marrow", "air", {("core", "air", "cortical_bone", "bone")}),
        ("marrow", "fat@0.95", {("core", "fat@0.95", "cortical_bone", "bone")}),
        ("marrow", "cortical_bone", set()),
        ("cortical_bone", "cortical_bone", set()),
    ],
)
def test_a_wrong_outside_material_of_an_inner_surface_is_reported(inside, outside, expected):
    scene = build_limb_scene(
        Surface(make_ball(30.0), "cortical_bone", "muscle", "bone"),
        Surface(make_box(20, 20, 20), inside, outside, "core"),
    )
    assert list_contradictions(scene) == expected


def test_an_inner_surface_that_protrudes_is_reported_for_both_surfaces():
    scene = build_limb_scene(
        Surface(make_box(40, 40, 40), "cortical_bone", "muscle", "bone"),
        Surface(make_box(10, 50, 10), "marrow", "cortical_bone", "canal"),
    )
    expected = {("canal", "cortical_bone", "muscle", "limb"), ("bone", "muscle", "marrow", "canal")}
    assert list_contradictions(scene) == expected
    assert all(one.longest_mm == pytest.approx(5.0, rel=0.01) for one in find_contradictions(scene, VIEW))


def test_each_wrong_outside_material_is_reported_with_the_found_surface():
    shells = (
        ("leg", 60, "muscle", "water"),
        ("bone", 50, "cortical_bone", "marrow"),
        ("nail", 40, "Ti@4.51", "adipose"),
    )
    scene = Scene([Surface(make_ball(radius), inside, outside, name) for name, radius, inside, outside in shells])
    found = find_contradictions(scene, VIEW)
    assert {(one.surface, one.stated_material, one.found_material, one.found_surface) for one in found} == {
        ("leg", "water", "air", ""), ("bone", "marrow", "muscle", "leg"), ("nail", "adipose", "cortical_bone", "bone"),
    }  # fmt: skip
    lengths_mm = {one.surface: one.longest_mm for one in find_contradictions(scene, VIEW)}
    assert lengths_mm == pytest.approx({"leg": 120, "bone": 100, "nail": 80}, rel=0.01)


def test_a_wrong_ambient_material_of_the_outermost_surface_is_reported():
    assert list_contradictions(Scene([Surface(make_ball(30.0), "water", "muscle", "ball")])) == {
        ("ball", "muscle", "air", "")
    }


def test_an_overlap_is_measured_and_a_slight_one_is_ignored():
    for deep_mm, expected in ((0.04, 0), (0.5, 2)):
        near, far = (
            make_box(20, 20, 20, at=(0, -10 + deep_mm / 2, 0)),
            make_box(20, 20, 20, at=(0, 10 - deep_mm / 2, 0)),
        )
        both = build_limb_scene(Surface(near, "water", "muscle", "near"), Surface(far, "water", "muscle", "far"))
        contrary = find_contradictions(both, VIEW)
        assert len(contrary) == expected
        for one in contrary:
            assert one.longest_mm == pytest.approx(deep_mm, rel=0.01)
            assert one.rays > 20


def test_contradictions_are_detected_from_a_source_inside_the_scene():
    view = View(source_mm=(1.0, 0.0, 2.0), centre_mm=(0.0, 200.0, 0.0), rows=16, cols=16, pixel_mm=8.0)
    shells = [
        Surface(make_ball(30.0), "cortical_bone", "muscle", "bone"),
        Surface(make_ball(10.0), "marrow", "cortical_bone"),
    ]
    assert not find_contradictions(build_limb_scene(*shells), view)
    wrong = [
        Surface(make_ball(30.0), "cortical_bone", "muscle", "bone"),
        Surface(make_ball(10.0), "marrow", "muscle", "core"),
    ]
    assert ("core", "muscle", "cortical_bone", "bone") in list_contradictions(build_limb_scene(*wrong), view)


def test_a_self_overlap_is_not_reported_as_a_material_contradiction():
    both = trimesh.util.concatenate([make_ball(20.0), make_ball(20.0, at=(0.0, 20.0, 0.0))])
    scene = build_limb_scene(Surface(both, "water", "muscle", "both"))
    assert not find_contradictions(scene, VIEW)
    (fold,) = find_self_overlaps(scene, VIEW)
    assert scene.surfaces[fold.surface].name == "both"
    assert fold.rays > 20
    assert fold.longest_mm == pytest.approx(20.0, rel=0.02)


def test_touching_walls_of_a_mesh_are_not_reported_as_self_overlap():
    beside = trimesh.util.concatenate([make_box(20, 20, 20), make_box(20, 20, 20, at=(0, 20, 0))])
    hole = make_box(10, 10, 10, at=(0, 5, 0))
    hole.invert()
    for mesh in (beside, trimesh.util.concatenate([make_box(20, 20, 20), hole])):
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(20), [1, 2, 3]))
        assert not find_self_overlaps(build_limb_scene(Surface(mesh, "water", "muscle")), VIEW)
