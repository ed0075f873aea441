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


def lattice(displacements=None, *, shaft=0, counts=(6, 5, 7), pitch=20.0, amount=1.0, seed=0):
    if displacements is None:
        displacements = np.random.default_rng(seed).normal(0.0, amount, (*counts, 3))
    return Lattice(
        origin_mm=np.array([-50.0, -40.0, -20.0]), pitch_mm=pitch, displacements_mm=displacements, shaft_sign=shaft
    )


def within(made, count=400, seed=1):
    """Places where every control point that matters is one of the lattice's own."""
    low = made.origin_mm + made.pitch_mm
    high = made.origin_mm + (np.array(made.counts) - 2) * made.pitch_mm
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def moves(points, made):
    return displace_points(points, made) - points


def test_control_points_that_all_move_alike_move_every_place_alike():
    made = lattice(np.broadcast_to([1.5, -2.0, 0.25], (6, 5, 7, 3)))
    assert_allclose(moves(within(made), made), np.tile([1.5, -2.0, 0.25], (400, 1)), atol=1e-12)


def test_displacements_that_are_linear_in_place_are_given_back():
    still = lattice(np.zeros((6, 5, 7, 3)))
    controls = still.origin_mm + 20.0 * np.stack(np.meshgrid(*map(np.arange, (6, 5, 7)), indexing="ij"), axis=-1)
    matrix = np.array([[0.02, 0.01, 0.0], [-0.03, 0.0, 0.05], [0.0, 0.04, -0.01]])
    made = replace_displacements(still, controls @ matrix.T + [1.0, 2.0, 3.0])
    places = within(made)
    assert_allclose(moves(places, made), places @ matrix.T + [1.0, 2.0, 3.0], atol=1e-12)


def test_one_control_point_moves_places_by_the_closed_form():
    one = np.zeros((6, 5, 7, 3))
    one[2, 2, 3] = [6.0, 0.0, -12.0]
    made = lattice(one)
    centre = made.origin_mm + 20.0 * np.array([2, 2, 3])
    away = np.linspace(-2.5, 2.5, 41)
    # The cubic B-spline: 2/3 - u^2 + |u|^3 / 2 within one pitch, (2 - |u|)^3 / 6 within two.
    u = np.abs(away)
    bell = np.where(u < 1, 2 / 3 - u**2 + u**3 / 2, np.clip(2 - u, 0, None) ** 3 / 6)
    for axis in range(3):
        places = np.tile(centre, (41, 1))
        places[:, axis] += 20.0 * away
        wanted = (bell * (2 / 3) ** 2)[:, None] * [6.0, 0.0, -12.0]
        assert_allclose(moves(places, made), wanted, atol=1e-12)


def test_deformations_add_up():
    first, second = lattice(seed=3, shaft=1), lattice(seed=4, shaft=1)
    both = replace_displacements(first, 2.0 * first.displacements_mm - 0.5 * second.displacements_mm)
    places = np.random.default_rng(0).uniform(-120, 250, (300, 3))
    assert_allclose(moves(places, both), 2.0 * moves(places, first) - 0.5 * moves(places, second), atol=1e-12)


def test_the_basis_gives_what_the_deformation_does():
    for shaft in (-1, 0, 1):
        made = lattice(shaft=shaft)
        places = np.random.default_rng(0).uniform(-150, 250, (500, 3))
        shares = basis_matrix(places, made)
        assert_allclose(shares @ made.displacements_mm.reshape(-1, 3), moves(places, made), atol=1e-12)
        assert_allclose(basis_matrix(within(made), made).sum(axis=1), 1.0, atol=1e-12)


def test_far_away_nothing_moves_and_it_fades_within_two_pitches():
    made = lattice(amount=5.0)
    low, high = made.origin_mm - 40.0, made.origin_mm + (np.array(made.counts) + 1) * 20.0
    for axis in range(3):
        for edge in (low[axis], high[axis], low[axis] - 500.0, high[axis] + 500.0):
            places = within(made)
            places[:, axis] = edge
            assert_array_equal(moves(places, made), 0.0)
        just_in = within(made)
        just_in[:, axis] = high[axis] - 20.0
        assert np.abs(moves(just_in, made)).max() > 0.05


@pytest.mark.parametrize("shaft", [1, -1])
def test_beyond_its_end_a_shaft_goes_on_as_its_last_layer(shaft):
    made = lattice(amount=3.0, shaft=shaft)
    end = made.origin_mm[2] + (20.0 * (made.counts[2] + 1) if shaft > 0 else -40.0)
    places = within(made)
    at_end, far = places.copy(), places.copy()
    at_end[:, 2], far[:, 2] = end, end + shaft * 300.0
    assert_allclose(moves(far, made), moves(at_end, made), atol=1e-12)
    assert np.abs(moves(far, made)).max() > 0.5
    other = places.copy()
    other[:, 2] = made.origin_mm[2] + (-40.0 if shaft > 0 else 20.0 * (made.counts[2] + 1))
    assert_array_equal(moves(other, made), 0.0)


@pytest.mark.parametrize("shaft", [-1, 0, 1])
def test_the_deformation_is_smooth_to_the_second_derivative(shaft):
    made = lattice(amount=4.0, shaft=shaft)
    along = np.arange(-150.0, 250.0, 0.05)
    places = np.column_stack((0.3 * along, 7.0 - 0.1 * along, along))
    third = np.diff(moves(places, made), 3, axis=0) / 0.05**3
    # A jump of the second derivative by 1 mm per squared pitch would show as 1 / 20^2 / 0.05 = 0.05.
    assert np.abs(third).max() < 0.02


def test_the_inverse_finds_where_places_came_from():
    made = lattice(amount=1.5, shaft=1)
    places = np.random.default_rng(0).uniform(-80, 200, (500, 3))
    assert_allclose(displace_points(invert_displacement(places, made), made), places, atol=1e-9)


def test_the_least_jacobian_is_that_of_finite_differences():
    made = lattice(amount=3.0, shaft=1)
    places = np.random.default_rng(0).uniform(made.origin_mm - 40, made.origin_mm + 160, (40_000, 3))
    step = 1e-4
    columns = [
        (displace_points(places + e, made) - displace_points(places - e, made)) / (2 * step) for e in step * np.eye(3)
    ]
    sampled = np.linalg.det(np.stack(columns, axis=-1)).min()
    assert min_jacobian_determinant(made) <= sampled + 0.01
    assert_allclose(min_jacobian_determinant(made), sampled, atol=0.08)


def test_a_lattice_at_rest_has_a_jacobian_of_1_and_one_that_folds_is_seen():
    assert min_jacobian_determinant(lattice(np.zeros((6, 5, 7, 3)))) == 1.0
    fold = np.zeros((6, 5, 7, 3))
    fold[2, :, :, 0], fold[3, :, :, 0] = 25.0, -25.0
    assert min_jacobian_determinant(lattice(fold)) < 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"pitch_mm": 0.0}, "pitch_mm .*0.0 mm"),
        ({"shaft_sign": 2}, "shaft_sign"),
        ({"displacements_mm": np.zeros((3, 3, 3))}, r"displacements_mm must have the shape .*, got \(3, 3, 3\)"),
        ({"displacements_mm": np.full((4, 4, 4, 3), np.nan)}, "displacements_mm must be finite, got nan mm"),
        ({"origin_mm": np.zeros(2)}, r"origin_mm must have the shape \(3,\), got \(2,\)"),
    ],
)
def test_a_lattice_that_is_none_is_refused(change, said):
    good = {"origin_mm": np.zeros(3), "pitch_mm": 20.0, "displacements_mm": np.zeros((4, 4, 4, 3)), "shaft_sign": 0}
    with pytest.raises(InputError, match=said):
        Lattice(**(good | change))
