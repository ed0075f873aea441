"""What surfaces say of each other, against what rays find."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from test_raycast import ball, box, detector, moved

from pssf import Scene, Surface
from pssf.geometry.view import View, resolve_view
from pssf.raycast.surface_overlaps import find_contradictions, find_self_overlaps

VIEW = resolve_view(detector(rows=64, cols=64, pixel_mm=3.0))
places = st.tuples(*3 * [st.floats(-8, 8)])


def limb(*surfaces):
    return Scene([Surface(ball(70.0), "muscle", "air", "limb"), *surfaces])


def said(scene, view=VIEW):
    return {
        (one.surface, one.stated_material, one.found_material, one.found_surface)
        for one in find_contradictions(scene, view)
    }


@settings(max_examples=15)
@given(at=places, turn=st.tuples(*3 * [st.floats(-180, 180)]), order=st.permutations(range(3)))
def test_shells_within_each_other_contradict_nothing_wherever_they_lie_and_in_any_order(at, turn, order):
    shells = [
        Surface(moved(box(50, 40, 60), at, turn), "cortical_bone", "muscle", "bone"),
        Surface(moved(box(40, 30, 50), at, turn), "trabecular_bone", "cortical_bone", "spongy"),
        Surface(moved(box(20, 10, 50), at, turn), "marrow", "trabecular_bone", "marrow"),  # its ends lie on a wall
    ]
    assert not find_contradictions(limb(*(shells[k] for k in order)), VIEW)


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
def test_a_core_is_surrounded_by_what_is_there(inside, outside, expected):
    scene = limb(
        Surface(ball(30.0), "cortical_bone", "muscle", "bone"), Surface(box(20, 20, 20), inside, outside, "core")
    )
    assert said(scene) == expected


def test_a_core_that_sticks_out_of_its_shell_is_seen_on_both_and_as_far_as_it_does():
    scene = limb(
        Surface(box(40, 40, 40), "cortical_bone", "muscle", "bone"),
        Surface(box(10, 50, 10), "marrow", "cortical_bone", "canal"),
    )
    expected = {("canal", "cortical_bone", "muscle", "limb"), ("bone", "muscle", "marrow", "canal")}
    assert said(scene) == expected
    assert all(one.longest_mm == pytest.approx(5.0, rel=0.01) for one in find_contradictions(scene, VIEW))


def test_each_of_several_shells_that_are_wrong_is_named_with_what_surrounds_it():
    shells = (
        ("leg", 60, "muscle", "water"),
        ("bone", 50, "cortical_bone", "marrow"),
        ("nail", 40, "Ti@4.51", "adipose"),
    )
    scene = Scene([Surface(ball(radius), inside, outside, name) for name, radius, inside, outside in shells])
    found = find_contradictions(scene, VIEW)
    assert {(one.surface, one.stated_material, one.found_material, one.found_surface) for one in found} == {
        ("leg", "water", "air", ""), ("bone", "marrow", "muscle", "leg"), ("nail", "adipose", "cortical_bone", "bone"),
    }  # fmt: skip
    ways_mm = {one.surface: one.longest_mm for one in find_contradictions(scene, VIEW)}
    assert ways_mm == pytest.approx({"leg": 120, "bone": 100, "nail": 80}, rel=0.01)


def test_what_an_outer_surface_says_of_the_ambient_is_held_against_it():
    assert said(Scene([Surface(ball(30.0), "water", "muscle", "ball")])) == {("ball", "muscle", "air", "")}


def test_the_way_is_measured_and_a_slight_overlap_is_passed_over():
    for deep_mm, expected in ((0.04, 0), (0.5, 2)):
        near, far = box(20, 20, 20, at=(0, -10 + deep_mm / 2, 0)), box(20, 20, 20, at=(0, 10 - deep_mm / 2, 0))
        both = limb(Surface(near, "water", "muscle", "near"), Surface(far, "water", "muscle", "far"))
        contrary = find_contradictions(both, VIEW)
        assert len(contrary) == expected
        for one in contrary:
            assert one.longest_mm == pytest.approx(deep_mm, rel=0.01)
            assert one.rays > 20


def test_from_a_source_within_the_scene_the_rest_of_it_is_judged():
    view = View(source_mm=(1.0, 0.0, 2.0), centre_mm=(0.0, 200.0, 0.0), rows=16, cols=16, pixel_mm=8.0)
    shells = [Surface(ball(30.0), "cortical_bone", "muscle", "bone"), Surface(ball(10.0), "marrow", "cortical_bone")]
    assert not find_contradictions(limb(*shells), view)
    wrong = [Surface(ball(30.0), "cortical_bone", "muscle", "bone"), Surface(ball(10.0), "marrow", "muscle", "core")]
    assert ("core", "muscle", "cortical_bone", "bone") in said(limb(*wrong), view)


def test_a_mesh_that_overlaps_itself_is_folded_and_contradicts_no_other():
    both = trimesh.util.concatenate([ball(20.0), ball(20.0, at=(0.0, 20.0, 0.0))])
    scene = limb(Surface(both, "water", "muscle", "both"))
    assert not find_contradictions(scene, VIEW)
    (fold,) = find_self_overlaps(scene, VIEW)
    assert scene.surfaces[fold.surface].name == "both"
    assert fold.rays > 20
    assert fold.longest_mm == pytest.approx(20.0, rel=0.02)


def test_walls_of_a_mesh_that_touch_are_no_fold():
    beside = trimesh.util.concatenate([box(20, 20, 20), box(20, 20, 20, at=(0, 20, 0))])
    hole = box(10, 10, 10, at=(0, 5, 0))
    hole.invert()
    for mesh in (beside, trimesh.util.concatenate([box(20, 20, 20), hole])):
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(20), [1, 2, 3]))
        assert not find_self_overlaps(limb(Surface(mesh, "water", "muscle")), VIEW)
