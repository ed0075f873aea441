"""Check the unevenness of cortical thickness."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pssf.anatomy.template.cortical_unevenness import MAX_SD, compute_thickness_factor
from pssf.data.anatomy.bone_tables import load_template_anatomy

TABLE = load_template_anatomy().unevenness


def sample_points(count=4000, seed=0):
    return np.random.default_rng(seed).uniform(-60, 60, (count, 3))


def compute_factor(thickness_mm, seed=5, bone="tibia", at=None):
    at = sample_points() if at is None else at
    return compute_thickness_factor(at, np.full(len(at), thickness_mm), TABLE, seed, bone)


def test_a_thin_cortex_has_the_tabulated_unevenness():
    # Clipping at 2 SD reduces the SD of a normal distribution to 0.88. Values within a knee are correlated, so 40 knees
    # are averaged.
    means, sds = zip(
        *[(s.mean(), s.std()) for s in (compute_factor(TABLE.thin_mm, seed) for seed in range(40))], strict=True
    )
    assert np.mean(means) == pytest.approx(1.0, abs=0.03)
    assert np.mean(sds) == pytest.approx(0.88 * TABLE.sd, rel=0.1)


@given(st.floats(0.1, 6.0), st.integers(0, 2**63 - 1))
def test_cortical_unevenness_is_limited_and_never_removes_the_cortex(thickness_mm, seed):
    thick = thickness_mm * compute_factor(thickness_mm, seed)
    assert thick.min() >= min(thickness_mm, TABLE.least_mm) * (1 - 1e-12)
    assert abs(thick - thickness_mm).max() <= MAX_SD * TABLE.sd * min(thickness_mm, TABLE.thin_mm) * (1 + 1e-9)


def test_cortical_unevenness_is_smooth_and_differs_per_bone_and_knee():
    at = sample_points()
    near = compute_factor(0.5, at=at + np.array([0.0, 0.0, 0.1])) - compute_factor(0.5, at=at)
    assert abs(near).max() < 0.1
    assert abs(np.corrcoef(compute_factor(0.5), compute_factor(0.5, bone="femur"))[0, 1]) < 0.3
    assert abs(np.corrcoef(compute_factor(0.5), compute_factor(0.5, seed=6))[0, 1]) < 0.3
    np.testing.assert_array_equal(compute_factor(0.5), compute_factor(0.5))
