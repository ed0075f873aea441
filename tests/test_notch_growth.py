"""Check bone growth into the notch: deformation, radiographic effect and sampling by grade."""

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


def test_growth_is_full_at_the_zone_centre_and_zero_at_its_edge():
    zone = GrowthZone(centre=(1.0, 2.0, 3.0), half=(4.0, 5.0, 6.0), direction=(0.0, -1.0, 0.5))
    points = np.array([[1.0, 2.0, 3.0], [5.0, 2.0, 3.0], [1.0, 2.0, 6.0], [9.0, 9.0, 9.0]])
    moves = compute_growth_mm(points, (zone,), 2.0)
    np.testing.assert_allclose(moves, np.outer([2.0, 0.0, 2.0 * 0.75**2, 0.0], zone.direction), rtol=0, atol=1e-12)
    assert not compute_growth_mm(points, (zone,), 0.0).any()


@pytest.mark.parametrize("bone", ["femur", "tibia"])
def test_the_maximum_growth_does_not_fold_the_bone(bone):
    zones = getattr(ZONES, bone)
    axes = [np.arange(-25.0, 25.0, 1.0), np.arange(-25.0, 35.0, 1.0), np.arange(-15.0, 35.0, 1.0)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    moved = (points.reshape(-1, 3) + compute_growth_mm(points.reshape(-1, 3), zones, MOST_MM)).reshape(points.shape)
    slopes = np.stack([np.gradient(moved, axis=axis) for axis in range(3)], axis=-1)
    assert np.linalg.det(slopes).min() > 0.2


def measure_heights_mm(knee):
    """Return the heights of spines and notch above the tibial edges in mm on the detector."""
    protocol = load_protocol("fixed_flexion")
    built = build(knee, protocol)
    truth = built.truth(built.aim_beam(protocol))
    rows = {name: point[0] for name, point in truth.landmarks_px.items()}
    base = (rows["tibia_medial_edge"] + rows["tibia_lateral_edge"]) / 2
    return np.array([(base - rows[name]) * protocol.pixel_mm for name in HEIGHTS])


def test_growth_raises_the_eminence_but_does_not_change_jsw():
    knees = [Knee(notch_growth_mm=mm, jsw_medial_mm=3.0) for mm in (0.0, 2.0)]
    before, after = map(measure_heights_mm, knees)
    raised = after - before
    # The spines rise less than the centre of the growth zone, which is between the spines.
    most = 2 * ZONES.tibia[0].direction[2]
    assert (raised[:2] > 0.36 * most).all()
    assert (raised[:2] < 1.15 * most).all()
    assert -3.5 < raised[2] < -1.2
    # The JSW under the protocol that defines JSW is unchanged.
    healthy, grown = (build(knee).measure_jsw_mm(load_protocol("reference")) for knee in knees)
    assert grown == pytest.approx(healthy, abs=1e-3)


def test_a_grade_4_knee_can_be_built_with_the_maximum_growth():
    knee = sample_knee(grade=4, rng=np.random.default_rng(5), grade_table="population")
    build(dataclasses.replace(knee, notch_growth_mm=MOST_MM))


def test_growth_above_the_maximum_is_rejected():
    with pytest.raises(InputError, match=r"notch_growth_mm must be .*, got 3\.5"):
        Knee(notch_growth_mm=3.5)


def sample_growth_mm(grade, seed, **options):
    return sample_knee(grade=grade, rng=np.random.default_rng(seed), **options).notch_growth_mm


def test_growth_rises_with_grade_but_does_not_separate_adjacent_grades():
    by_grade = [
        np.array([sample_growth_mm(grade, seed, grade_table="population") for seed in range(200)]) for grade in range(5)
    ]
    assert np.all(np.diff([grown.mean() for grown in by_grade]) > 0)
    # The margin is three standard errors of an AUC from 200 knees per grade.
    error = 3 * np.sqrt(1 / (6 * 200))
    for less, more in itertools.pairwise(by_grade):
        assert mannwhitneyu(more, less).statistic / 200**2 < 0.7 + error
    assert sample_growth_mm(2, 0, grade_table="paper") == 0.0
