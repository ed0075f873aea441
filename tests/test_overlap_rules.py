"""Rules for overlapping bodies of a scene: closed forms of the path lengths, warnings and errors."""

import dataclasses
import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import pssf
from pssf.raycast import resolve_overlaps

# One ray along y through the origin.
RAY = dataclasses.replace(
    pssf.load_protocol("reference"), rows=1, cols=1, focal_spot_mm=0.0, scatter="none", noise="none",
)  # fmt: skip


def make_body(name, material, length_mm, middle_mm, outside="air", across_mm=40.0):
    """Make a box along y."""
    box = trimesh.creation.box((across_mm, length_mm, across_mm))
    box.apply_translation((0.0, middle_mm, 0.0))
    return pssf.Surface(box, material, outside, name)


def trace_ray(scene, engine="scanline"):
    """Return the path length in each material, in mm."""
    return {name: float(mm[0, 0]) for name, mm in pssf.trace(scene, RAY, engine=engine).path_mm.items()}


def make_pair(overlap):
    """Make two bodies that share 10 mm of the ray."""
    return pssf.Scene(
        [make_body("one", "muscle", 30.0, 0.0), make_body("other", "cortical_bone", 30.0, 20.0, across_mm=30.0)],
        overlap=overlap,
    )


@pytest.mark.parametrize("engine", ["embree", "scanline"])
@pytest.mark.parametrize(
    ("overlap", "muscle", "bone"), [("sum", 30, 30), ("warn", 30, 30), ("refuse", 30, 30), ("first", 30, 20)]
)
def test_the_rule_determines_the_paths_in_two_bodies(overlap, muscle, bone, engine):
    paths = trace_ray(make_pair(overlap), engine)
    assert_allclose([paths["muscle"], paths["cortical_bone"]], [muscle, bone], atol=1e-5)


def test_the_order_of_the_bodies_determines_which_one_is_cut():
    scene = make_pair("first")
    paths = trace_ray(pssf.Scene(scene.surfaces[::-1], overlap="first"))
    assert_allclose([paths["muscle"], paths["cortical_bone"]], [20, 30], atol=1e-5)


def test_bodies_inside_a_cut_body_are_cut_as_well():
    scene = pssf.Scene(
        [
            make_body("nail", "titanium_alloy", 20.0, 0.0, across_mm=10.0),
            make_body("limb", "muscle", 100.0, 0.0),
            make_body("bone", "cortical_bone", 60.0, 0.0, outside="muscle", across_mm=30.0),
            make_body("marrow", "marrow", 40.0, 0.0, outside="cortical_bone", across_mm=20.0),
        ],
        overlap="first",
    )
    paths = trace_ray(scene)
    expected = {"titanium_alloy": 20.0, "muscle": 40.0, "cortical_bone": 20.0, "marrow": 20.0}
    for name, mm in expected.items():
        assert_allclose(paths[name], mm, atol=1e-5, err_msg=name)


@settings(max_examples=20, deadline=None)
@given(
    lengths=st.lists(st.floats(5, 60), min_size=2, max_size=4),
    middles=st.lists(st.floats(-40, 40), min_size=4, max_size=4),
)
def test_with_first_the_paths_add_up_to_the_union_of_the_bodies(lengths, middles):
    bodies = [
        make_body(f"body {k}", "muscle", length, middle, across_mm=40.0 - 3 * k)
        for k, (length, middle) in enumerate(zip(lengths, middles, strict=False))
    ]
    ends = sorted((middle - length / 2, middle + length / 2) for length, middle in zip(lengths, middles, strict=False))
    union, reached = 0.0, -np.inf
    for start, stop in ends:
        union += max(0.0, stop - max(start, reached))
        reached = max(reached, stop)
    assert_allclose(trace_ray(pssf.Scene(bodies, overlap="first"))["muscle"], union, atol=1e-4)


def test_the_voxels_of_the_monte_carlo_simulation_follow_the_rule():
    scene = make_pair("first")
    assert resolve_overlaps(scene) is resolve_overlaps(scene)
    protocol = dataclasses.replace(RAY, rows=64, cols=64, pixel_mm=2.0, scatter="monte_carlo", scatter_photons=40_000)
    parts = [
        pssf.simulate(pssf.Scene(surfaces, overlap="sum"), protocol, keep=("scatter",)).kept["scatter"]
        for surfaces in (resolve_overlaps(scene).surfaces, scene.surfaces)
    ]
    found = pssf.simulate(scene, protocol, keep=("scatter",)).kept["scatter"]
    assert np.array_equal(found, parts[0])


def test_simulate_warns_of_an_overlap_unless_a_rule_is_given():
    with pytest.warns(
        pssf.ImageNotice, match=r"surfaces one and other overlap, over up to .* of a ray, where the paths"
    ):
        pssf.simulate(make_pair("warn"), RAY, engine="scanline")
    for rule in ("sum", "first"):
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            pssf.simulate(make_pair(rule), RAY, engine="scanline")
        assert not [one for one in raised if "overlap" in str(one.message)]


def test_simulate_refuses_an_overlap_if_requested():
    with pytest.raises(pssf.InputError, match=r"overlap = 'refuse' must not overlap, got: surfaces one and other"):
        pssf.simulate(make_pair("refuse"), RAY, engine="scanline")


def test_disjoint_and_nested_bodies_cause_no_warning():
    scene = pssf.Scene([
        make_body("limb", "muscle", 100.0, 0.0),
        make_body("bone", "cortical_bone", 60.0, 0.0, outside="muscle", across_mm=30.0),
        make_body("filter", "Al@2.7", 2.0, -80.0),
    ])  # fmt: skip
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        pssf.simulate(scene, RAY, engine="scanline")
    assert not [one for one in raised if "surfaces" in str(one.message)]
    first = pssf.Scene(scene.surfaces, overlap="first")
    assert resolve_overlaps(first) is first


def test_an_unknown_rule_is_refused():
    with pytest.raises(pssf.InputError, match="overlap must be"):
        pssf.Scene([], overlap="last")
