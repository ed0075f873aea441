"""Check sampled acquisitions, the central ray, the collimator and the side marker."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import pssf
from pssf import InputError
from pssf.data.imaging.acquisition_table import load_acquisition_variability
from pssf.scatter.monte_carlo import simulate_photons
from pssf.xray.collimator import compute_collimator_transmission
from pssf.xray.resolved_technique import resolve_technique

FIXED_FLEXION = pssf.load_protocol("fixed_flexion")
PLAIN = dict(rows=256, cols=256, pixel_mm=1.2, texture="none", noise="none")
COARSE = dataclasses.replace(FIXED_FLEXION, **PLAIN)


def sample_protocol(seed, protocol=FIXED_FLEXION, side="right"):
    return pssf.sample_acquisition(protocol, rng=np.random.default_rng(seed), side=side)


@pytest.fixture(scope="module")
def built():
    return pssf.build(pssf.Knee(), COARSE)


@pytest.fixture(scope="module")
def radiograph(built):
    return pssf.simulate(built, COARSE, keep=("primary", "scatter"))


@given(st.integers(0, 2**32), st.sampled_from(["reference", "fixed_flexion", "caudal_beam", "low_dose"]))
def test_a_sampled_acquisition_is_valid_and_reproducible(seed, name):
    protocol = pssf.load_protocol(name)
    sampled = sample_protocol(seed, protocol)
    assert sampled == sample_protocol(seed, protocol)
    assert sampled.sdd_mm - sampled.sod_mm == pytest.approx(protocol.sdd_mm - protocol.sod_mm, abs=2e-3)
    assert sampled.marker in ("R", "none")
    assert (sampled.flexion_deg == 0) == (protocol.flexion_deg == 0)
    assert sampled.tube_kv == round(sampled.tube_kv)


def test_sampled_acquisitions_have_the_tabulated_spread():
    table, sampled = load_acquisition_variability(), [sample_protocol(seed) for seed in range(1500)]
    # Truncating a normal distribution at two standard deviations reduces the SD to 0.88 of the original.
    for name, sd in table.spread.items():
        values = np.array([getattr(protocol, name) for protocol in sampled])
        assert_allclose(values.mean(), getattr(FIXED_FLEXION, name), atol=4 * sd / np.sqrt(len(sampled)))
        assert_allclose(values.std(), 0.88 * sd, rtol=0.08)
    for name, sd in table.factor.items():
        assert_allclose(np.log([getattr(protocol, name) for protocol in sampled]).std(), 0.88 * sd, rtol=0.08)
    assert_allclose(np.mean([protocol.marker == "R" for protocol in sampled]), table.marker.share, atol=0.04)


def test_the_side_marker_agrees_with_the_side_of_the_knee():
    assert {sample_protocol(seed, side="left").marker for seed in range(30)} == {"L", "none"}
    assert {sample_protocol(seed, side=None).marker for seed in range(30)} == {"none"}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"protocol": "fixed_flexion"}, "protocol must be a Protocol, .* got 'fixed_flexion'"),
        ({"rng": "3"}, "rng must be a whole number"),
        ({"side": "up"}, "side must be one of right, left.*, got 'up'"),
    ],
)
def test_invalid_arguments_of_sample_acquisition_are_rejected(wrong, message):
    given = {"protocol": FIXED_FLEXION, "rng": np.random.default_rng(0)} | wrong
    with pytest.raises(InputError, match=message):
        pssf.sample_acquisition(given.pop("protocol"), **given)


def test_moving_the_central_ray_moves_the_knee_in_the_image(built, radiograph):
    protocol = dataclasses.replace(COARSE, centre_x_mm=12.0, centre_z_mm=-20.0)
    shifted = pssf.simulate(built, protocol)
    moved = np.subtract(shifted.truth.landmarks_px["joint_centre"], radiograph.truth.landmarks_px["joint_centre"])
    scale = COARSE.sdd_mm / (COARSE.sod_mm * np.cos(np.deg2rad(COARSE.beam_angle_deg))) / COARSE.pixel_mm
    assert_allclose(moved, [-20.0 * scale, -12.0 * scale], rtol=0.04)
    # Moving the central ray changes the projection, and thus the joint space label, slightly.
    assert shifted.truth.jsw_medial_mm == pytest.approx(radiograph.truth.jsw_medial_mm, abs=0.4)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_tilted_leg_appears_tilted_in_the_image_with_the_same_jsw(side):
    knee = pssf.Knee(side=side)
    straight, tilted = (
        pssf.build(knee, dataclasses.replace(COARSE, tilt_deg=degrees)).truth(
            dataclasses.replace(COARSE, tilt_deg=degrees)
        )
        for degrees in (0.0, 6.0)
    )

    def slope(truth):
        medial, lateral = (np.array(truth.landmarks_px[f"tibia_{end}_edge"]) for end in ("medial", "lateral"))
        row, col = medial - lateral
        return np.degrees(np.arctan2(row, abs(col)))

    # The foot moves medially, which raises the medial end of the plateau.
    assert slope(tilted) - slope(straight) == pytest.approx(-6.0, abs=0.3)
    assert tilted.jsw_medial_mm == pytest.approx(straight.jsw_medial_mm, abs=0.02)


def test_a_collimator_blocks_the_outer_beam_and_reduces_scatter(built, radiograph):
    protocol = dataclasses.replace(COARSE, field_width_mm=120.0, field_height_mm=180.0)
    found = pssf.simulate(built, protocol, keep=("primary", "scatter"))
    transmission = compute_collimator_transmission(resolve_technique(protocol))
    assert_allclose(transmission.sum() * COARSE.pixel_mm**2, 120.0 * 180.0, rtol=1e-3)
    within, beyond = transmission == 1, transmission == 0
    assert np.array_equal(found.kept["primary"][within], radiograph.kept["primary"][within])
    assert (found.kept["primary"][beyond] == 0).all()
    assert found.kept["scatter"].sum() < 0.8 * radiograph.kept["scatter"].sum()
    assert (found.kept["scatter"][within] <= radiograph.kept["scatter"][within] * (1 + 1e-4)).all()


def test_the_penumbra_of_the_field_has_the_width_of_the_focal_spot_blur():
    protocol = dataclasses.replace(COARSE, cols=2000, pixel_mm=0.05, field_width_mm=60.0, focal_spot_mm=1.2)
    row = compute_collimator_transmission(resolve_technique(protocol))[100]
    wide = ((row > 0.02) & (row < 0.98)).sum() / 2 * 0.05 / 0.96
    assert_allclose(wide, 1.2 * (protocol.sdd_mm / 300.0 - 1), rtol=0.02)


def test_primary_photons_stay_inside_the_collimated_field():
    scene = pssf.Scene([pssf.Surface(trimesh.creation.box((150.0, 40.0, 150.0)), "muscle", "air")])
    protocol = dataclasses.replace(COARSE, field_width_mm=100.0, field_height_mm=100.0, beam_angle_deg=0.0)
    counts = simulate_photons(scene, resolve_technique(protocol), photons=40_000, seed=1)
    primary = counts.primary_kev.mean(axis=0)
    side_mm = counts.pixels_per_cell * COARSE.pixel_mm
    middle = (np.arange(len(primary)) + 0.5) * side_mm - COARSE.rows * COARSE.pixel_mm / 2
    outside = np.abs(middle) > 50.0 + side_mm
    assert primary[outside].sum() == primary[:, outside].sum() == 0
    assert primary[~outside][:, ~outside].sum() > 0


def test_a_lead_marker_is_only_in_the_upper_corner_of_the_field(built, radiograph):
    small = dict(field_width_mm=200.0, field_height_mm=240.0)
    plain = pssf.simulate(built, dataclasses.replace(COARSE, **small)).pixels.astype(float)
    for letter, left in (("R", True), ("L", False)):
        marked = pssf.simulate(built, dataclasses.replace(COARSE, **small, marker=letter)).pixels.astype(float)
        rows, cols = np.nonzero(marked < 0.6 * plain)
        assert len(rows) > 8
        assert (rows < 128).all()
        assert (cols < 128).all() if left else (cols > 128).all()
        assert np.abs(marked - plain)[128:].max() < 60


def test_the_truth_labels_contain_the_sampled_acquisition():
    knee = pssf.Knee(flexion_deg=3.0, rotation_deg=-2.0, lean_deg=1.5)
    protocol = pssf.sample_acquisition(COARSE, rng=np.random.default_rng(5), side="right")
    acquisition = pssf.build(knee, protocol).truth(protocol).acquisition
    changed = {
        field.name
        for field in dataclasses.fields(protocol)
        if getattr(protocol, field.name) != getattr(COARSE, field.name)
    }
    assert changed - {"sod_mm"} <= acquisition.keys()
    own = {"flexion_deg": 3.0, "rotation_deg": -2.0, "tilt_deg": 1.5}
    assert acquisition == {
        name: getattr(protocol, name) if name not in own else pytest.approx(getattr(protocol, name) + own[name])
        for name in acquisition
    }
