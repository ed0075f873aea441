"""Test for degenerate features: constant or non-finite features, which contain no information."""

import numpy as np
from numpy.typing import NDArray


def is_degenerate(values: NDArray[np.float64]) -> bool:
    """Check whether a feature is constant except for rounding errors or has a non-finite value.

    Parameters
    ----------
    values : (rows,) float array, any unit
        Values of the feature.

    Returns
    -------
    bool
        True if the feature contains no information.
    """
    if not np.isfinite(values).all():
        return True
    largest = float(np.abs(values).max(initial=0.0))
    return largest < 1e-12 or float(np.ptp(values)) <= 1e-9 * largest
