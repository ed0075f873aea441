"""Check both knees on one detector: position and labels of each knee agree with those of a single knee."""

import dataclasses

import numpy as np
import pydicom
import pytest
from numpy.testing import assert_allclose

import pssf
from pssf import InputError
from pssf.anatomy import build_pair
from pssf.geometry.view import magnification, resolve_view

BILATERAL = pssf.load_protocol("bilateral")
SMALL = dataclasses.replace(BILATERAL, rows=BILATERAL.rows // 16, cols=BILATERAL.cols // 16, pixel_mm=0.15 * 16)
RIGHT = pssf.Knee(jsw_medial_mm=4.2, jsw_lateral_mm=5.1, jsw_definition="read", texture_seed=1)
LEFT = dataclasses.replace(RIGHT, side="left")


@pytest.fixture(scope="module")
def pair():
    return build_pair(RIGHT, LEFT, BILATERAL)


def test_the_bilateral_detector_is_43_by_35_centimetres():
    assert (BILATERAL.cols * BILATERAL.pixel_mm, BILATERAL.rows * BILATERAL.pixel_mm) == pytest.approx(
        (430, 350), abs=0.1
    )


def test_paths_through_both_knees_are_the_sum_of_those_through_each(pair):
    def trace_surfaces(surfaces):
        return pssf.trace(pssf.Scene(surfaces), SMALL, engine="scanline").path_mm

    both = trace_surfaces(pair.scene.surfaces)
    parts = [trace_surfaces([s for s in pair.scene.surfaces if s.name.startswith(side)]) for side in ("right", "left")]
    assert both["cortical_bone"].max() > 5
    for material, path_mm in both.items():
        assert_allclose(path_mm, parts[0][material] + parts[1][material], atol=1e-3)


def test_identical_knees_are_mirror_images_with_the_right_knee_on_the_left(pair):
    radiograph = pssf.simulate(pair, dataclasses.replace(SMALL, noise="none"), engine="scanline", keep=("masks",))
    pixels = radiograph.pixels.astype(float)
    assert_allclose(pixels, pixels[:, ::-1], rtol=0.02)
    right, left = radiograph.truths
    assert np.flatnonzero(right.masks["femur"].any(axis=0)).max() < SMALL.cols / 2
    assert np.flatnonzero(left.masks["femur"].any(axis=0)).min() > SMALL.cols / 2
    for name, (row, col) in right.landmarks_px.items():
        assert_allclose(left.landmarks_px[name], (row, SMALL.cols - 1 - col), atol=1e-6)


def test_labels_of_both_knees_agree_with_their_masks(pair):
    protocol = dataclasses.replace(BILATERAL, rows=583, cols=716, pixel_mm=0.6)
    truths = pssf.simulate(pair, protocol, engine="scanline", keep=("masks",)).truths
    # The central ray passes between the knees, so the projected JSW differs slightly from the specified JSW.
    assert truths[0].jsw_medial_mm == pytest.approx(4.2, abs=0.3)
    for truth in truths:
        row, col = truth.landmarks_px["medial_spine"]
        assert np.flatnonzero(truth.masks["tibia"][:, round(col)])[0] == pytest.approx(row, abs=1.5)
        (top, _), (bottom, _) = (truth.landmarks_px[f"medial_jsw_{bone}"] for bone in ("femur", "tibia"))
        assert truth.jsw_medial_mm == pytest.approx(
            (bottom - top) * 0.6 / magnification(resolve_view(protocol)), abs=0.05
        )


def test_a_radiograph_of_both_knees_is_loaded_unchanged(pair, tmp_path):
    one = pssf.simulate(pair, SMALL, engine="scanline", rng=4)
    assert one.knee is None
    assert one.truth is None
    assert [knee.side for knee in one.knees] == ["right", "left"]
    for suffix in ("tif", "dcm"):
        assert pssf.load(pssf.save(one, tmp_path / f"both.{suffix}")) == one


def test_masks_of_both_knees_are_loaded_with_the_side_in_their_names(pair, tmp_path):
    one = pssf.simulate(pair, SMALL, engine="scanline", keep=("masks",))
    for suffix in ("tif", "dcm"):
        back = pssf.load_masks(pssf.save_masks(one, tmp_path / f"both.{suffix}"))
        for knee, truth in zip(one.knees, one.truths, strict=True):
            assert (back[f"{knee.side}_patella"] == truth.masks["patella"]).all()
        assert len(back) == sum(len(truth.masks) for truth in one.truths)
    segments = {one.SegmentLabel: one for one in pydicom.dcmread(tmp_path / "both.dcm").SegmentSequence}
    for side, code in (("right", "24028007"), ("left", "7771000")):
        region = segments[f"{side}_femur"].AnatomicRegionSequence[0]
        assert region.AnatomicRegionModifierSequence[0].CodeValue == code


@pytest.mark.parametrize(
    ("knees", "more", "why"),
    [
        ((LEFT, RIGHT), {}, r"a right and a left Knee in this order, got left as the right knee"),
        (
            (RIGHT, "left"),
            {},
            r"knee must be a Knee, a BuiltKnee, a \(right, left\) pair of them, or a Scene, got 'left'",
        ),
        ((RIGHT, LEFT, LEFT), {}, r"knee must be a Knee, a BuiltKnee, a \(right, left\) pair of them, or a Scene"),
        ((RIGHT, LEFT), dict(knee_distance_mm=0.0), r"knee_distance_mm must be above 0 mm for two knees"),
        ((RIGHT, LEFT), dict(beam_along="medial_plateau"), r"beam_along must be 'horizontal' for two knees"),
        (RIGHT, {}, r"knee_distance_mm must be 0 for one knee, got 210 mm"),
    ],
)
def test_an_invalid_pair_raises_an_error_with_the_reason(knees, more, why):
    with pytest.raises(InputError, match=why):
        pssf.simulate(knees, dataclasses.replace(SMALL, **more))


def test_the_error_for_overlapping_legs_states_the_required_distance(pair):
    with pytest.raises(InputError, match=r"must be more than 1\d\d mm for these legs, got 80 mm: the legs overlap"):
        build_pair(*pair.knees, dataclasses.replace(BILATERAL, knee_distance_mm=80.0))
    with pytest.raises(InputError, match=r"knee_distance_mm must be 210 mm, as in build, got 200 mm"):
        pssf.simulate(pair, dataclasses.replace(SMALL, knee_distance_mm=200.0))


def test_a_sampled_pair_has_one_body_and_independent_joints():
    right, left = pssf.sample_knee_pair(grade=3, rng=np.random.default_rng(5), grade_table="population")
    assert (right.side, left.side) == ("right", "left")
    assert right.grade == left.grade == 3
    for name in (
        "sex",
        "stature_mm",
        "bmi",
        "limb_ap_mm",
        "fat_mm",
        "age_years",
        "shape",
        "bone_scale",
        "bone_density",
    ):
        assert getattr(right, name) == getattr(left, name), name
    for name in ("jsw_medial_mm", "texture_seed", "flexion_deg", "osteophytes"):
        assert getattr(right, name) != getattr(left, name), name
    assert pssf.sample_knee_pair(grade=3, rng=np.random.default_rng(5), grade_table="population") == (right, left)
    fixed = pssf.sample_knee_pair(grade=3, rng=np.random.default_rng(5), grade_table="population", bmi=31.0)
    assert fixed[0].bmi == fixed[1].bmi == 31.0
    assert fixed[0].limb_ap_mm == fixed[1].limb_ap_mm != right.limb_ap_mm
