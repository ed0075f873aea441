"""Check the distance between located and true joint line."""

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from pssf.study.statistics.features.localisation_error import add_localisation_errors, summarise_localisation


def test_localisation_errors_are_in_mm_and_failures_are_counted():
    table = pd.DataFrame(
        {
            "protocol": ["reference"] * 3,
            "grade": [0, 0, 1],
            "status": ["found", "low score", "found"],
            "score": [0.9, 0.1, 0.8],
            "row_px": [103.0, 0.0, 100.0],
            "col_px": [204.0, 0.0, 200.0],
            "truth_medial_row_px": [100.0] * 3,
            "truth_medial_col_px": [200.0] * 3,
            "pixel_mm": [0.15] * 3,
            "sdd_mm": [1200.0] * 3,
            "sod_mm": [1000.0] * 3,
        }
    )
    found = summarise_localisation(add_localisation_errors(table))
    assert list(found["rejected"]) == [1, 0, 1]
    assert found["mean_px"].tolist() == [5.0, 0.0, 2.5]
    assert_allclose(found["mean_mm"], np.array([5.0, 0.0, 2.5]) * 0.15 / 1.2)
