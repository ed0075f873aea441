"""Degenerate features, which carry no information."""

import numpy as np
from numpy.typing import NDArray


def is_degenerate(values: NDArray[np.float64]) -> bool:
    """Check that a feature is constant except for rounding, or has a value that is not finite.

    Parameters
    ----------
    values : (rows,) float array, any unit
        Values of the feature.

    Returns
    -------
    bool
        True if the feature carries no information.
    """
    if not np.isfinite(values).all():
        return True
    largest = float(np.abs(values).max(initial=0.0))
    return largest < 1e-12 or float(np.ptp(values)) <= 1e-9 * largest
