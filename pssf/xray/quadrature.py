"""Few energies instead of a whole spectrum: as many as the thicknesses of a scene need, with a stated error.

What passes a scene is a sum of exponentials over the bins of the spectrum. A handful of them with weights of their own
gives the same sum over a bounded range of thicknesses: a quadrature, fitted by non-negative least squares.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ..core.checks import Array

# Largest relative error that is left, on mixtures that the fit has not seen; the least and the most nodes tried.
TOLERANCE = 5e-4
_FEWEST, _MOST = 4, 24
_FITTED, _CHECKED = 300, 1500
# Signal that is less than this part of the open beam's rounds to nothing.
_NOTHING = 1e-12
_STEPS = (8, 4, 2, 1)


def spectrum_quadrature(
    weights: Array, other: Array, mu_per_mm: Array, most_mm: Array, tolerance: float = TOLERANCE
) -> tuple[NDArray[np.int64], Array, Array, float]:
    """The bins to keep of a spectrum, and their weights.

    weights    (bins,)  of the open beam in the signal, keV/mm2
    other      (bins,)  in a second sum over the same bins, keV2/mm2, that of squares, fitted on the same nodes
    mu_per_mm  (materials, bins)
    most_mm    (materials,)  thickness up to which each is met
    tolerance  largest relative error of the signal
    returns    bins (nodes,), weights (nodes,) and weights of the second sum (nodes,), and the error that is left;
               all bins as they are if no small number will do
    """
    rng = np.random.default_rng(1)
    fitted, checked = (_relative(rng, count, weights, mu_per_mm, most_mm) for count in (_FITTED, _CHECKED))
    for count in range(_FEWEST, min(_MOST, len(weights) - 1) + 1):
        bins = _chosen(fitted, weights, count)
        factors = _weights(fitted, bins)[0]
        error = float(np.abs(checked[:, bins] @ factors - 1).max())
        if error <= tolerance:
            bins, factors = bins[factors > 0], factors[factors > 0]
            squares = _relative(np.random.default_rng(1), _FITTED, other, mu_per_mm, most_mm)
            return bins, weights[bins] * factors, other[bins] * _weights(squares, bins)[0], error
    return np.arange(len(weights)), weights, other, 0.0


def _relative(rng: np.random.Generator, count: int, weights: Array, mu_per_mm: Array, most_mm: Array) -> Array:
    """(mixtures, bins)  share of each bin in what passes mixtures of materials, from nothing to the most of each"""
    mixtures = rng.random((count, len(most_mm))) * (rng.random((count, len(most_mm))) < 0.5) * most_mm
    mixtures[0], mixtures[1] = 0.0, most_mm
    passed = weights * np.exp(-mixtures @ mu_per_mm)
    total = passed.sum(axis=1)
    seen = total > _NOTHING * weights.sum()
    return np.asarray(passed[seen] / total[seen, None])


def _weights(shares: Array, bins: NDArray[np.int64]) -> tuple[Array, float]:
    """Factors on the chosen bins that bring every sum of shares nearest to 1, and the largest error."""
    factors, _ = nnls(shares[:, bins], np.ones(len(shares)))
    return factors, float(np.abs(shares[:, bins] @ factors - 1).max())


def _chosen(shares: Array, weights: Array, count: int) -> NDArray[np.int64]:
    """Bins that share out the root of the signal, each then moved while that lowers the largest error."""
    cumulated = np.cumsum(np.sqrt(weights))
    bins = np.unique(np.searchsorted(cumulated, (np.arange(count) + 0.5) / count * cumulated[-1]))
    error = _weights(shares, bins)[1]
    for step in _STEPS:
        for place in range(len(bins)):
            for way in (-step, step):
                moved = bins.copy()
                moved[place] += way
                if not 0 <= moved[place] < len(weights) or len(np.unique(moved)) < len(moved):
                    continue
                error_moved = _weights(shares, moved)[1]
                if error_moved < error:
                    bins, error = moved, error_moved
    return np.sort(bins)
