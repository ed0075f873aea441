"""Check the detection of constant features."""

import numpy as np

from pssf.study.statistics.features.degenerate_features import is_degenerate


def test_a_feature_that_varies_only_by_rounding_is_degenerate():
    assert is_degenerate(np.array([1.0, 1.0 + 1e-15, 1.0 - 1e-15]))
    assert is_degenerate(np.array([1e-17, -1e-17]))
    assert is_degenerate(np.array([1.0, np.nan]))
    assert not is_degenerate(np.array([1e-6, 2e-6]))
