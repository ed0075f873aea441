"""Which features carry nothing."""

import numpy as np
from numpy.typing import NDArray


def is_degenerate(values: NDArray[np.float64]) -> bool:
    """Whether a feature is the same for all but for rounding, or not finite: it can tell nothing from anything.

    values  (rows,)  any unit
    """
    if not np.isfinite(values).all():
        return True
    largest = float(np.abs(values).max(initial=0.0))
    return largest < 1e-12 or float(np.ptp(values)) <= 1e-9 * largest
