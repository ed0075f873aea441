"""Check free-form deformation by B-spline lattices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pssf.core.checks import InputError
from pssf.geometry.freeform_deformation import (
    Lattice,
    basis_matrix,
    displace_points,
    invert_displacement,
    min_jacobian_determinant,
    replace_displacements,
)


def make_lattice(displacements=None, *, shaft=0, counts=(6, 5, 7), pitch=20.0, amount=1.0, seed=0):
    if displacements is None:
        displacements = np.random.default_rng(seed).normal(0.0, amount, (*counts, 3))
    return Lattice(
        origin_mm=np.array([-50.0, -40.0, -20.0]), pitch_mm=pitch, displacements_mm=displacements, shaft_sign=shaft
    )


def sample_points(lattice, count=400, seed=1):
    """Return random points at which all influencing control points belong to the lattice."""
    low = lattice.origin_mm + lattice.pitch_mm
    high = lattice.origin_mm + (np.array(lattice.counts) - 2) * lattice.pitch_mm
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def compute_displacements(points, lattice):
    return displace_points(points, lattice) - points


def test_equal_control_point_displacements_move_all_points_equally():
    lattice = make_lattice(np.broadcast_to([1.5, -2.0, 0.25], (6, 5, 7, 3)))
    assert_allclose(
        compute_displacements(sample_points(lattice), lattice), np.tile([1.5, -2.0, 0.25], (400, 1)), atol=1e-12
    )


def test_linear_displacements_are_reproduced():
    still = make_lattice(np.zeros((6, 5, 7, 3)))
    controls = still.origin_mm + 20.0 * np.stack(np.meshgrid(*map(np.arange, (6, 5, 7)), indexing="ij"), axis=-1)
    matrix = np.array([[0.02, 0.01, 0.0], [-0.03, 0.0, 0.05], [0.0, 0.04, -0.01]])
    lattice = replace_displacements(still, controls @ matrix.T + [1.0, 2.0, 3.0])
    points = sample_points(lattice)
    assert_allclose(compute_displacements(points, lattice), points @ matrix.T + [1.0, 2.0, 3.0], atol=1e-12)


def test_one_control_point_moves_points_by_the_cubic_b_spline():
    one = np.zeros((6, 5, 7, 3))
    one[2, 2, 3] = [6.0, 0.0, -12.0]
    lattice = make_lattice(one)
    centre = lattice.origin_mm + 20.0 * np.array([2, 2, 3])
    distances = np.linspace(-2.5, 2.5, 41)
    # The cubic B-spline is 2/3 - u^2 + |u|^3 / 2 up to one pitch and (2 - |u|)^3 / 6 from one to two pitches.
    u = np.abs(distances)
    bell = np.where(u < 1, 2 / 3 - u**2 + u**3 / 2, np.clip(2 - u, 0, None) ** 3 / 6)
    for axis in range(3):
        points = np.tile(centre, (41, 1))
        points[:, axis] += 20.0 * distances
        expected = (bell * (2 / 3) ** 2)[:, None] * [6.0, 0.0, -12.0]
        assert_allclose(compute_displacements(points, lattice), expected, atol=1e-12)


def test_displacements_are_linear_in_the_control_points():
    first, second = make_lattice(seed=3, shaft=1), make_lattice(seed=4, shaft=1)
    both = replace_displacements(first, 2.0 * first.displacements_mm - 0.5 * second.displacements_mm)
    points = np.random.default_rng(0).uniform(-120, 250, (300, 3))
    assert_allclose(
        compute_displacements(points, both),
        2.0 * compute_displacements(points, first) - 0.5 * compute_displacements(points, second),
        atol=1e-12,
    )


def test_the_basis_matrix_reproduces_the_displacements():
    for shaft in (-1, 0, 1):
        lattice = make_lattice(shaft=shaft)
        points = np.random.default_rng(0).uniform(-150, 250, (500, 3))
        basis = basis_matrix(points, lattice)
        assert_allclose(
            basis @ lattice.displacements_mm.reshape(-1, 3), compute_displacements(points, lattice), atol=1e-12
        )
        assert_allclose(basis_matrix(sample_points(lattice), lattice).sum(axis=1), 1.0, atol=1e-12)


def test_displacements_vanish_two_pitches_beyond_the_lattice():
    lattice = make_lattice(amount=5.0)
    low, high = lattice.origin_mm - 40.0, lattice.origin_mm + (np.array(lattice.counts) + 1) * 20.0
    for axis in range(3):
        for edge in (low[axis], high[axis], low[axis] - 500.0, high[axis] + 500.0):
            points = sample_points(lattice)
            points[:, axis] = edge
            assert_array_equal(compute_displacements(points, lattice), 0.0)
        inside = sample_points(lattice)
        inside[:, axis] = high[axis] - 20.0
        assert np.abs(compute_displacements(inside, lattice)).max() > 0.05


@pytest.mark.parametrize("shaft", [1, -1])
def test_the_shaft_continues_the_displacement_of_the_last_layer(shaft):
    lattice = make_lattice(amount=3.0, shaft=shaft)
    end = lattice.origin_mm[2] + (20.0 * (lattice.counts[2] + 1) if shaft > 0 else -40.0)
    points = sample_points(lattice)
    at_end, far = points.copy(), points.copy()
    at_end[:, 2], far[:, 2] = end, end + shaft * 300.0
    assert_allclose(compute_displacements(far, lattice), compute_displacements(at_end, lattice), atol=1e-12)
    assert np.abs(compute_displacements(far, lattice)).max() > 0.5
    other = points.copy()
    other[:, 2] = lattice.origin_mm[2] + (-40.0 if shaft > 0 else 20.0 * (lattice.counts[2] + 1))
    assert_array_equal(compute_displacements(other, lattice), 0.0)


@pytest.mark.parametrize("shaft", [-1, 0, 1])
def test_the_deformation_has_a_continuous_second_derivative(shaft):
    lattice = make_lattice(amount=4.0, shaft=shaft)
    along = np.arange(-150.0, 250.0, 0.05)
    points = np.column_stack((0.3 * along, 7.0 - 0.1 * along, along))
    third = np.diff(compute_displacements(points, lattice), 3, axis=0) / 0.05**3
    # A discontinuity of 1 mm per squared pitch in the second derivative would give 1 / 20^2 / 0.05 = 0.05.
    assert np.abs(third).max() < 0.02


def test_the_inverse_displacement_recovers_the_original_points():
    lattice = make_lattice(amount=1.5, shaft=1)
    points = np.random.default_rng(0).uniform(-80, 200, (500, 3))
    assert_allclose(displace_points(invert_displacement(points, lattice), lattice), points, atol=1e-9)


def test_the_minimum_jacobian_agrees_with_finite_differences():
    lattice = make_lattice(amount=3.0, shaft=1)
    points = np.random.default_rng(0).uniform(lattice.origin_mm - 40, lattice.origin_mm + 160, (40_000, 3))
    step = 1e-4
    columns = [
        (displace_points(points + e, lattice) - displace_points(points - e, lattice)) / (2 * step)
        for e in step * np.eye(3)
    ]
    sampled = np.linalg.det(np.stack(columns, axis=-1)).min()
    assert min_jacobian_determinant(lattice) <= sampled + 0.01
    assert_allclose(min_jacobian_determinant(lattice), sampled, atol=0.08)


def test_the_minimum_jacobian_is_1_at_rest_and_negative_in_a_fold():
    assert min_jacobian_determinant(make_lattice(np.zeros((6, 5, 7, 3)))) == 1.0
    fold = np.zeros((6, 5, 7, 3))
    fold[2, :, :, 0], fold[3, :, :, 0] = 25.0, -25.0
    assert min_jacobian_determinant(make_lattice(fold)) < 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pitch_mm": 0.0}, "pitch_mm .*0.0 mm"),
        ({"shaft_sign": 2}, "shaft_sign"),
        ({"displacements_mm": np.zeros((3, 3, 3))}, r"displacements_mm must have the shape .*, got \(3, 3, 3\)"),
        ({"displacements_mm": np.full((4, 4, 4, 3), np.nan)}, "displacements_mm must be finite, got nan mm"),
        ({"origin_mm": np.zeros(2)}, r"origin_mm must have the shape \(3,\), got \(2,\)"),
    ],
)
def test_an_invalid_lattice_is_rejected(change, message):
    good = {"origin_mm": np.zeros(3), "pitch_mm": 20.0, "displacements_mm": np.zeros((4, 4, 4, 3)), "shaft_sign": 0}
    with pytest.raises(InputError, match=message):
        Lattice(**(good | change))
