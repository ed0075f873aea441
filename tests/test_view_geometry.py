"""Projection geometry of a view: source, detector, magnification and validation."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pssf import (
    InputError,
    Scene,
    Surface,
    check,
    load_protocol,
    simulate,
    trace,
)
from pssf.geometry.view import (
    View,
    magnification,
    project_points,
    resolve_view,
)


@given(angle=st.floats(-20, 20), sod=st.floats(900, 1000), gap=st.floats(10, 200))
def test_the_central_ray_passes_through_the_origin_and_detector_centre(angle, sod, gap):
    protocol = dataclasses.replace(load_protocol("reference"), beam_angle_deg=angle, sod_mm=sod, sdd_mm=sod + gap)
    view = resolve_view(protocol)
    assert_allclose(np.linalg.norm(view.source_mm), sod)
    centre = (protocol.rows - 1) / 2, (protocol.cols - 1) / 2
    assert_allclose(project_points(np.zeros((1, 3)), view)[0], centre, atol=1e-6)


def test_a_positive_angle_moves_the_source_proximally():
    protocol = dataclasses.replace(load_protocol("reference"), beam_angle_deg=5.0)
    assert resolve_view(protocol).source_mm[2] > 0


def test_rows_increase_distally_and_columns_in_the_direction_of_plus_x():
    view = resolve_view(load_protocol("reference"))
    (row, col), (up, _), (_, right) = project_points(np.array([[0.0, 0, 0], [0, 0, 10], [10, 0, 0]]), view)
    assert up < row
    assert right > col
    assert right - col == pytest.approx(10 * magnification(view) / view.pixel_mm)


def test_the_reference_magnifies_the_joint_plane_by_sdd_over_sod():
    assert magnification(resolve_view(load_protocol("reference"))) == pytest.approx(1150 / 950)


GOOD = {"source_mm": (0.0, -900.0, 0.0), "centre_mm": (0.0, 200.0, 0.0), "rows": 9, "cols": 9, "pixel_mm": 9.0}


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("centre_mm", (0.0, -900.0, 0.0), "y of centre_mm minus y of source_mm must be between 1e-06 .*, got 0.0 mm"),
        ("centre_mm", (0.0, -1000.0, 0.0), "y of centre_mm minus y of source_mm must be .*, got -100.0 mm"),
        ("source_mm", (float("nan"), -900.0, 0.0), "x of source_mm must be .*, got nan mm"),
        ("source_mm", (0.0, -np.inf, 0.0), "y of source_mm must be .*, got -inf mm"),
        ("source_mm", (0.0, 0.0, 1e200), "z of source_mm must be .*, got 1e"),
        ("source_mm", (0.0, -900.0), r"source_mm must be three numbers in mm, got \(0.0, -900.0\)"),
        ("source_mm", None, "source_mm must be .*, got None"),
        ("source_mm", ("0", "1", "2"), "x of source_mm must be .*, got '0'"),
        ("centre_mm", "far", "centre_mm must be .*, got 'far'"),
        ("rows", 0, "rows must be a whole number from 1 .*, got 0 pixels"),
        ("rows", 2.5, "rows must be .*, got 2.5"),
        ("cols", -3, "cols must be .*, got -3"),
        ("cols", True, "cols must be .*, got True"),
        ("pixel_mm", 0.0, "pixel_mm must be .*, got 0.0 mm"),
        ("pixel_mm", -1.0, "pixel_mm must be .*, got -1.0"),
        ("pixel_mm", float("nan"), "pixel_mm must be .*, got nan"),
        ("pixel_mm", None, "pixel_mm must be .*, got None"),
    ],
)
def test_an_invalid_view_raises_an_error(field, value, why):
    with pytest.raises(InputError, match=f"^view: {why}"):
        View(**{**GOOD, field: value})


def test_a_view_accepts_lists_and_arrays_as_positions():
    lists = View(**{**GOOD, "source_mm": [0, -900, 0], "centre_mm": np.array([0.0, 200.0, 0.0])})
    assert lists == View(**GOOD)
    assert hash(lists) == hash(View(**GOOD))
    assert {type(part) for part in (*lists.source_mm, *lists.centre_mm)} == {float}


def test_only_protocols_and_views_can_be_resolved_to_a_view():
    assert resolve_view(View(**GOOD)) == View(**GOOD)
    scene = Scene([Surface(trimesh.creation.box(extents=3 * [10]), "water", "air")])
    for thing in ("reference", None, {"sdd_mm": 1150}, scene):
        for function in (resolve_view, lambda view: trace(scene, view)):
            with pytest.raises(InputError, match=r"^protocol must be a Protocol or a View, got .*: use load_protocol"):
                function(thing)
    with pytest.raises(InputError, match=r"^protocol must be a Protocol or a View, got 'reference'"):
        check(scene, "reference")


@pytest.mark.parametrize(("shift_x_px", "shift_z_px"), [(24, 0), (0, -16), (-12, 20)])
def test_an_offset_detector_shows_a_part_of_a_larger_detector(shift_x_px, shift_z_px):
    whole = dataclasses.replace(
        load_protocol("reference"), rows=128, cols=128, pixel_mm=2.0, heel="anode_proximal", scatter="none",
        noise="none", detector_blur="none", focal_spot_mm=0.0, beam_angle_deg=5.0,
    )  # fmt: skip
    part = dataclasses.replace(
        whole, rows=64, cols=64, detector_offset_x_mm=2.0 * shift_x_px, detector_offset_z_mm=2.0 * shift_z_px
    )
    ball = trimesh.creation.icosphere(subdivisions=3, radius=40.0).apply_translation((20.0, 0.0, 15.0))
    scene = Scene([Surface(ball, "muscle", "air", "ball")])
    images = [simulate(scene, one, rng=0, keep=("primary",), engine="scanline") for one in (whole, part)]
    top, left = 32 - shift_z_px, 32 + shift_x_px
    expected = images[0].kept["primary"][top : top + 64, left : left + 64]
    # The spline of the heel effect has other nodes on the smaller detector.
    assert_allclose(images[1].kept["primary"], expected, rtol=2e-4)
