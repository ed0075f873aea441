"""Check integrals of density fields along rays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pssf import InputError, PlaneWaves
from pssf.geometry.density import Density, TranslatedDensity, integrate_along_segments

coordinate = st.floats(-3, 3)


@settings(max_examples=60)
@given(
    wave=st.tuples(coordinate, coordinate, coordinate),
    phase=st.floats(-10, 10),
    end=st.tuples(coordinate, coordinate, coordinate),
)
def test_the_integral_of_a_wave_agrees_with_numerical_integration(wave, phase, end):
    waves = PlaneWaves(mean=0.7, amplitudes=(0.4,), waves_per_mm=(wave,), phases=(phase,))
    start, end = np.array([0.3, -0.2, 0.5]), np.array(end)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    points = start + (nodes[:, None] + 1) / 2 * (end - start)
    values = 0.7 + 0.4 * np.cos(points @ np.array(wave) + phase)
    expected = (weights * values).sum() / 2 * np.linalg.norm(end - start)
    assert_allclose(waves.integrate(start[None], end[None]), expected, rtol=0, atol=1e-12)


def test_a_wave_perpendicular_to_the_ray_is_constant_along_it():
    start, end = np.zeros((3, 3)), np.array([[0.0, 40.0, 0.0]] * 3)
    for across in (0.0, 1e-9, 1e-5):
        waves = PlaneWaves(mean=0.0, amplitudes=(1.0,), waves_per_mm=((2.0, across, 0.0),), phases=(0.5,))
        middle = np.cos(0.5 + across * 20) * np.sinc(across * 20 / np.pi) * 40
        assert_allclose(waves.integrate(start, end), middle, rtol=1e-14)


def test_integrals_of_two_segments_add_up_to_that_of_both():
    rng = np.random.default_rng(1)
    waves = PlaneWaves(amplitudes=(0.2, 0.3), waves_per_mm=((1.0, 2.0, 3.0), (-7.0, 0.1, 4.0)), phases=(0.0, 1.0))
    a, c = rng.normal(size=(2, 50, 3))
    b = 0.3 * a + 0.7 * c
    assert_allclose(waves.integrate(a, b) + waves.integrate(b, c), waves.integrate(a, c), atol=1e-13)
    assert isinstance(waves, Density)


def test_invalid_plane_waves_are_rejected():
    with pytest.raises(InputError, match=r"plane waves: .* must have equal lengths, got \(2, 1, 1\)"):
        PlaneWaves(amplitudes=(1.0, 2.0), waves_per_mm=((1.0, 0.0, 0.0),), phases=(0.0,))
    with pytest.raises(InputError, match="plane waves: all numbers must be finite, got nan"):
        PlaneWaves(mean=float("nan"))
    with pytest.raises(InputError, match=r"plane waves: a wave must have three components .*, got 2: \(1.0, 0.0\)"):
        PlaneWaves(amplitudes=(1.0,), waves_per_mm=((1.0, 0.0),), phases=(0.0,))


class Any:
    """Density field whose integral is always a specified value."""

    def __init__(self, given):
        self.integrate = lambda starts_mm, ends_mm: given


STARTS, ENDS = np.zeros((3, 3)), np.full((3, 3), 2.0)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (3.0, "got 3.0"),
        (None, "got None"),
        ("much", "got 'much'"),
        (np.ones((3, 1)), r"got float64 of shape \(3, 1\)"),
        (np.ones(4), r"got float64 of shape \(4,\)"),
        (np.ones(3, complex), r"got complex128 of shape \(3,\)"),
        (["1", "2", "3"], r"got <U1 of shape \(3,\)"),
        ([[1.0], [1.0, 2.0], []], r"got object of shape"),
        ([1.0, np.nan, np.nan], r"got nan for 2 segments, first from \(0, 0, 0\) to \(2, 2, 2\) mm"),
        ([1.0, 2.0, -np.inf], "got -inf for 1 segments"),
    ],
)
def test_a_density_must_return_one_finite_number_per_segment(given, why):
    with pytest.raises(
        InputError, match=rf"^Any.integrate must return \(3,\) finite numbers in mm, one for each segment, {why}"
    ):
        integrate_along_segments(Any(given), STARTS, ENDS)


@pytest.mark.parametrize("given", [[1, 2, 3], (1.0, 2.0, 3.0), np.array([1, 2, 3], np.float32)])
def test_a_density_may_return_any_sequence_of_numbers(given):
    assert_allclose(integrate_along_segments(Any(given), STARTS, ENDS), [1, 2, 3])


@given(by=st.tuples(coordinate, coordinate, coordinate))
def test_translating_a_density_field_and_rays_preserves_the_integrals(by):
    waves = PlaneWaves(mean=0.7, amplitudes=(0.4,), waves_per_mm=((0.3, -0.8, 1.1),), phases=(0.2,))
    starts, ends = np.random.default_rng(2).uniform(-20, 20, (2, 9, 3))
    moved = TranslatedDensity(density=waves, offset_mm=by)
    assert_allclose(moved.integrate(starts + by, ends + by), waves.integrate(starts, ends), rtol=1e-9, atol=1e-9)
