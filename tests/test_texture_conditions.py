"""Test the comparison of texture measures between acquisitions."""

from dataclasses import asdict

import numpy as np
import pytest

from pssf.validation.study_methods import texture_conditions as conditions


def test_equal_measurements_agree_and_shifted_ones_do_not():
    values = np.random.default_rng(1).normal(2.5, 0.1, 200)
    same = conditions._compare_pairs(np.stack((values, values), axis=1))
    assert same == pytest.approx({"r": 1.0, "icc": 1.0, "shift_sd": 0.0, "cv_percent": 0.0})
    shifted = conditions._compare_pairs(np.stack((values, values + 0.2), axis=1))
    spread = values.std(ddof=1)
    assert shifted["r"] == pytest.approx(1.0)
    assert shifted["shift_sd"] == pytest.approx(0.2 / spread)
    # Absolute agreement: between / (between + squared shift / 2) for noiseless pairs.
    assert shifted["icc"] == pytest.approx(spread**2 / (spread**2 + 0.2**2 / 2), rel=0.02)
    assert shifted["cv_percent"] == pytest.approx(100 * 0.2 / np.sqrt(2) / (values.mean() + 0.1))


def test_each_condition_differs_from_the_reference_in_one_respect():
    _, reference = conditions._sample_case(3)
    listed = conditions._list_conditions(reference, 3)
    changed = {
        name: {field for field, value in asdict(one).items() if value != asdict(reference)[field]}
        for name, one in listed.items()
    }
    assert changed.pop("noise") == set()
    assert len(changed.pop("repeat")) > 5
    assert changed.pop("pixel_0.2") == {"pixel_mm", "rows", "cols"}
    assert all(len(fields) == 1 for fields in changed.values()), changed
    assert listed["magnification"].sdd_mm / listed["magnification"].sod_mm == pytest.approx(
        reference.sdd_mm / reference.sod_mm / 0.91
    )
