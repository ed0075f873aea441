"""Reduction of a spectrum to a few energies, with a known error.

The transmission of a scene is a sum of exponentials over the bins of the spectrum. For a limited range of thicknesses,
a few bins with fitted weights give nearly the same sum. The weights of this quadrature are fitted by non-negative least
squares.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ..core.checks import Array

# Largest allowed relative error for mixtures of materials that are not part of the fit.
RELATIVE_TOLERANCE = 1e-4
# Smallest number of energies in the search.
_FEWEST = 4
# Largest number of energies in the search.
_MOST = 24
# Number of random mixtures of materials for the fit.
_FITTED = 300
# Number of random mixtures of materials for the check of the error.
_CHECKED = 1500
# Smallest signal of a mixture used in the fit or the check, as a fraction of the open-beam signal.
_NEGLIGIBLE_SIGNAL = 1e-12
# Steps, in bins, by which the search moves the selected energies.
_SEARCH_STEPS = (8, 4, 2, 1)


def fit_spectrum_quadrature(
    weights: Array, square_weights: Array, mu_per_mm: Array, max_path_mm: Array, tolerance: float = RELATIVE_TOLERANCE
) -> tuple[NDArray[np.int64], Array, Array, float]:
    """Select a few bins of a spectrum and fit their weights.

    Parameters
    ----------
    weights : (bins,) array, keV/mm2
        Contribution of each bin to the open-beam signal.
    square_weights : (bins,) array, keV2/mm2
        Contribution of each bin to the sum of squared energies in the open beam, which is fitted with the same bins.
    mu_per_mm : (materials, bins) array, 1/mm
        Linear attenuation coefficients.
    max_path_mm : (materials,) array, mm
        Maximum path length in each material.
    tolerance : float, default 1e-4
        Largest allowed relative error of the signal.

    Returns
    -------
    bins : (nodes,) int64 array
        Indices of the selected bins. All bins are selected if 24 bins do not reach the tolerance.
    weights : (nodes,) float64 array
        Weights of the signal, in keV/mm2.
    square_weights : (nodes,) float64 array
        Weights of the sum of squared energies, in keV2/mm2.
    error : float
        Largest relative error of the signal for the check mixtures.
    """
    rng = np.random.default_rng(1)
    fitted, checked = (
        _sample_bin_fractions(rng, count, weights, mu_per_mm, max_path_mm) for count in (_FITTED, _CHECKED)
    )
    for count in range(_FEWEST, min(_MOST, len(weights) - 1) + 1):
        bins = _select_bins(fitted, weights, count)
        factors = _fit_weights(fitted, bins)[0]
        error = float(np.abs(checked[:, bins] @ factors - 1).max())
        if error <= tolerance:
            bins, factors = bins[factors > 0], factors[factors > 0]
            squares = _sample_bin_fractions(np.random.default_rng(1), _FITTED, square_weights, mu_per_mm, max_path_mm)
            return bins, weights[bins] * factors, square_weights[bins] * _fit_weights(squares, bins)[0], error
    return np.arange(len(weights)), weights, square_weights, 0.0


def _sample_bin_fractions(
    rng: np.random.Generator, count: int, weights: Array, mu_per_mm: Array, max_path_mm: Array
) -> Array:
    """Compute the contribution of each bin to the signal behind random mixtures of materials, (mixtures, bins).

    Contributions are fractions of the signal of each mixture. Path lengths are from 0 to the maximum of each material.
    """
    mixtures = rng.random((count, len(max_path_mm))) * (rng.random((count, len(max_path_mm))) < 0.5) * max_path_mm
    mixtures[0], mixtures[1] = 0.0, max_path_mm
    passed = weights * np.exp(-mixtures @ mu_per_mm)
    total = passed.sum(axis=1)
    seen = total > _NEGLIGIBLE_SIGNAL * weights.sum()
    return np.asarray(passed[seen] / total[seen, None])


def _fit_weights(bin_fractions: Array, bins: NDArray[np.int64]) -> tuple[Array, float]:
    """Fit factors for the selected bins, so that the weighted contributions add up to 1 for every mixture.

    Return the factors and the largest deviation from 1.
    """
    factors, _ = nnls(bin_fractions[:, bins], np.ones(len(bin_fractions)))
    return factors, float(np.abs(bin_fractions[:, bins] @ factors - 1).max())


def _select_bins(bin_fractions: Array, weights: Array, count: int) -> NDArray[np.int64]:
    """Select bins at equal steps of the cumulative square root of the weights, then move them to reduce the error.

    A bin is moved only if the move reduces the largest error.
    """
    cumulated = np.cumsum(np.sqrt(weights))
    bins = np.unique(np.searchsorted(cumulated, (np.arange(count) + 0.5) / count * cumulated[-1]))
    error = _fit_weights(bin_fractions, bins)[1]
    for step in _SEARCH_STEPS:
        for place in range(len(bins)):
            for way in (-step, step):
                moved = bins.copy()
                moved[place] += way
                if not 0 <= moved[place] < len(weights) or len(np.unique(moved)) < len(moved):
                    continue
                error_moved = _fit_weights(bin_fractions, moved)[1]
                if error_moved < error:
                    bins, error = moved, error_moved
    return np.sort(bins)
