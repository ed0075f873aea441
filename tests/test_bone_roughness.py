"""Check the surface roughness of bones: zones, amplitude, smoothness and unchanged joint spaces."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pssf
from pssf.anatomy.template.bone_roughness import Seeds, compute_roughness_mm, is_in_zones
from pssf.data.anatomy.bone_tables import load_template_anatomy

AP = pssf.load_protocol("reference")
ZONES = {
    "femur": (load_template_anatomy().femur.roughness_zones, +1),
    "tibia": (load_template_anatomy().tibia.roughness_zones, -1),
}


def sample_points(count=4000, seed=0):
    return np.random.default_rng(seed).uniform(-70, 70, (count, 3))


@given(st.sampled_from(sorted(ZONES)), st.integers(0, 2**63 - 1))
def test_roughness_is_zero_outside_its_zones_and_limited_inside(bone, seed):
    zones, end = ZONES[bone]
    moves, at = compute_roughness_mm(sample_points(), zones, Seeds(seed, seed), end), sample_points()
    assert not moves[~is_in_zones(at, zones)].any()
    assert np.linalg.norm(moves, axis=1).max() <= 2.0 * sum(
        zone.sd_mm * np.linalg.norm(zone.direction) for zone in zones
    )


@pytest.mark.parametrize("bone", sorted(ZONES))
def test_roughness_at_the_centre_of_a_zone_has_the_tabulated_sd(bone):
    zones, end = ZONES[bone]
    zone = zones[0]
    lone = (zone,)
    middle = np.array([zone.centre])
    moves = np.array(
        [compute_roughness_mm(middle, lone, Seeds(seed, 0), end)[0] @ zone.direction for seed in range(2000)]
    ) / np.dot(zone.direction, zone.direction)
    # Clipping a normal distribution at two SD reduces its SD to 0.96; the standard error of 2000 samples is 1.6 %.
    assert moves.std() == pytest.approx(0.96 * zone.sd_mm, rel=0.06)
    assert abs(moves.mean()) < 4 * zone.sd_mm / np.sqrt(2000)


def test_roughness_is_smooth_and_reproducible():
    zones, end = ZONES["tibia"]
    at = sample_points()
    zones = tuple(zone for zone in zones if zone.seed_stream == "texture")
    moves = compute_roughness_mm(at, zones, Seeds(3, 0), end)
    np.testing.assert_array_equal(moves, compute_roughness_mm(at, zones, Seeds(3, 0), end))
    assert abs(compute_roughness_mm(at + 0.05, zones, Seeds(3, 0), end) - moves).max() < 0.1
    other = compute_roughness_mm(at, zones, Seeds(4, 0), end)
    within = is_in_zones(at, zones)
    assert abs(np.corrcoef(moves[within].ravel(), other[within].ravel())[0, 1]) < 0.3


@pytest.mark.parametrize("bone", sorted(ZONES))
def test_form_roughness_depends_only_on_the_form_seed(bone):
    zones, end = ZONES[bone]
    zones, at = tuple(zone for zone in zones if zone.seed_stream == "form"), sample_points()
    moves = compute_roughness_mm(at, zones, Seeds(3, 3), end)
    np.testing.assert_array_equal(moves, compute_roughness_mm(at, zones, Seeds(4, 3), end))
    assert abs(compute_roughness_mm(at, zones, Seeds(3, 4), end) - moves).max() > 0.5
    assert abs(compute_roughness_mm(at + 0.05, zones, Seeds(3, 3), end) - moves).max() < 0.05


def test_a_new_texture_seed_changes_bone_surfaces_but_not_jsw():
    # The pose is fitted to the specified JSW for each seed; roughness affects only bone without cartilage.
    knee = pssf.Knee(jsw_medial_mm=3.0, varus_deg=2.0)
    one, two, formed = (pssf.build(replace(knee, **seeds), AP) for seeds in ({}, {"texture_seed": 2}, {"form_seed": 2}))
    for built in (one, two, formed):
        np.testing.assert_allclose(built.measure_jsw_mm(AP), (3.0, knee.jsw_lateral_mm), atol=1e-3)
    spines = [built.part_meshes()["tibia"].vertices[:, 2].max() for built in (one, two, formed)]
    assert len(set(spines)) == 3
