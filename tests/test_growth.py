"""Bone that grows into the notch: moved smoothly and without a fold, seen on films, and drawn by grade."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from pssf import (
    InputError,
    Knee,
    build,
    load_protocol,
    sample_knee,
)
from pssf.anatomy.template.bone_roughness import compute_growth_mm
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.data.anatomy.bone_tables import GrowthZone

ZONES = load_anatomy_tables().template.notch_growth
MOST_MM = 3.0
HEIGHTS = ("lateral_spine", "medial_spine", "notch_top")


def test_the_middle_of_a_zone_moves_by_all_its_edge_by_nothing_and_no_growth_is_none():
    zone = GrowthZone(centre=(1.0, 2.0, 3.0), half=(4.0, 5.0, 6.0), direction=(0.0, -1.0, 0.5))
    points = np.array([[1.0, 2.0, 3.0], [5.0, 2.0, 3.0], [1.0, 2.0, 6.0], [9.0, 9.0, 9.0]])
    moves = compute_growth_mm(points, (zone,), 2.0)
    np.testing.assert_allclose(moves, np.outer([2.0, 0.0, 2.0 * 0.75**2, 0.0], zone.direction), rtol=0, atol=1e-12)
    assert not compute_growth_mm(points, (zone,), 0.0).any()


@pytest.mark.parametrize("bone", ["femur", "tibia"])
def test_bone_that_grows_by_the_most_a_knee_may_have_does_not_fold(bone):
    zones = getattr(ZONES, bone)
    axes = [np.arange(-25.0, 25.0, 1.0), np.arange(-25.0, 35.0, 1.0), np.arange(-15.0, 35.0, 1.0)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    moved = (places.reshape(-1, 3) + compute_growth_mm(places.reshape(-1, 3), zones, MOST_MM)).reshape(places.shape)
    slopes = np.stack([np.gradient(moved, axis=axis) for axis in range(3)], axis=-1)
    assert np.linalg.det(slopes).min() > 0.2


def heights(knee):
    """Heights of spines and notch's top above the tibia's edges, mm on the film."""
    protocol = load_protocol("fixed_flexion")
    built = build(knee, protocol)
    truth = built.truth(built.aim_beam(protocol))
    rows = {name: place[0] for name, place in truth.landmarks_px.items()}
    base = (rows["tibia_medial_edge"] + rows["tibia_lateral_edge"]) / 2
    return np.array([(base - rows[name]) * protocol.pixel_mm for name in HEIGHTS])


def test_growth_raises_the_eminence_and_lowers_the_notch_and_joint_spaces_stay():
    knees = [Knee(notch_growth_mm=mm, jsw_medial_mm=3.0) for mm in (0.0, 2.0)]
    before, after = map(heights, knees)
    raised = after - before
    # Spines lie beside the zone's middle, which rises most.
    most = 2 * ZONES.tibia[0].direction[2]
    assert (raised[:2] > 0.36 * most).all()
    assert (raised[:2] < 1.15 * most).all()
    assert -3.5 < raised[2] < -1.2
    # Joint spaces stay in the protocol that they are specified under.
    healthy, grown = (build(knee).measure_jsw_mm(load_protocol("reference")) for knee in knees)
    assert grown == pytest.approx(healthy, abs=1e-3)


def test_a_narrow_joint_of_a_worn_knee_with_spikes_has_room_for_it():
    knee = sample_knee(grade=4, rng=np.random.default_rng(5), grade_table="population")
    build(dataclasses.replace(knee, notch_growth_mm=MOST_MM))


def test_more_than_grows_is_refused():
    with pytest.raises(InputError, match=r"notch_growth_mm must be .*, got 3\.5"):
        Knee(notch_growth_mm=3.5)


def grown_mm(grade, seed, **options):
    return sample_knee(grade=grade, rng=np.random.default_rng(seed), **options).notch_growth_mm


def test_it_grows_with_the_grade_but_tells_no_grade_from_the_next():
    by_grade = [
        np.array([grown_mm(grade, seed, grade_table="population") for seed in range(200)]) for grade in range(5)
    ]
    assert np.all(np.diff([grown.mean() for grown in by_grade]) > 0)
    # Three standard errors of an AUC from so many knees.
    error = 3 * np.sqrt(1 / (6 * 200))
    for less, more in itertools.pairwise(by_grade):
        assert mannwhitneyu(more, less).statistic / 200**2 < 0.7 + error
    assert grown_mm(2, 0, grade_table="paper") == 0.0
