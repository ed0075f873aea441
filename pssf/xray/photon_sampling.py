"""Compiled sampling of photon interactions: scattering angles, energies and directions.

A photon is an array (7,): position x, y, z in mm, direction u, v, w, and energy in keV. These functions are called only
by compiled functions.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper
from .photon_interactions import HC_KEV_A, STEP_X

# Rest energy of the electron, in keV.
_ELECTRON_KEV = 510.99895


@kernel_helper(inline="always")
def sample_uniform(s: NDArray[np.uint64]) -> float:
    """Sample a uniform number in [0, 1) with xoshiro256++ (Blackman and Vigna 2019).

    Parameters
    ----------
    s : (4,) uint64 array
        State of the generator, not all zero; updated in place.

    Returns
    -------
    float
        Uniform random number.
    """
    total = s[0] + s[3]
    mixed = ((total << np.uint64(23)) | (total >> np.uint64(41))) + s[0]
    moved = s[1] << np.uint64(17)
    s[2] ^= s[0]
    s[3] ^= s[1]
    s[1] ^= s[2]
    s[0] ^= s[3]
    s[2] ^= moved
    s[3] = (s[3] << np.uint64(45)) | (s[3] >> np.uint64(19))
    return (mixed >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@kernel_helper(inline="always")
def find_first_above(values: Array, threshold: float) -> int:
    """Find the first ascending value above a threshold.

    Parameters
    ----------
    values : (n,) float64 array, any unit
        Ascending values.
    threshold : float
        Threshold in the unit of `values`.

    Returns
    -------
    int
        Index of the first value above the threshold, or the last index if no value is above it.
    """
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        if values[middle] > threshold:
            high = middle
        else:
            low = middle + 1
    return low


@kernel_helper(inline="always")
def interpolate(table: Array, place: float) -> float:
    """Interpolate a table linearly at a fractional index.

    Parameters
    ----------
    table : (n,) float64 array, any unit
        Values at indices 0 to n - 1.
    place : float
        Index from 0 to n - 1, which may be a fraction.

    Returns
    -------
    float
        Value in the unit of the table.
    """
    node = min(int(place), len(table) - 2)
    return table[node] + (place - node) * (table[node + 1] - table[node])


@kernel()
def sample_compton(kev: float, stream: NDArray[np.uint64], incoherent_function: Array) -> tuple[float, float]:
    """Sample the cosine of the scattering angle and the remaining energy fraction of Compton scattering.

    The Klein-Nishina formula is sampled by composition and rejection (Butcher and Messel 1960).

    Parameters
    ----------
    kev : float
        Photon energy, in keV.
    stream : (4,) uint64 array
        State of the random number generator; updated in place.
    incoherent_function : (x,) float64 array, dimensionless
        Incoherent scattering function divided by the number of electrons, from 0 to 1, in steps of `STEP_X`.

    Returns
    -------
    cosine : float
        Cosine of the scattering angle.
    share : float
        Energy of the scattered photon divided by `kev`.
    """
    k = kev / _ELECTRON_KEV
    least = 1.0 / (1.0 + 2.0 * k)
    one, two = -math.log(least), 0.5 * (1.0 - least * least)
    while True:
        if sample_uniform(stream) * (one + two) < one:
            share = math.exp(-one * sample_uniform(stream))
        else:
            share = math.sqrt(least * least + (1.0 - least * least) * sample_uniform(stream))
        t = (1.0 - share) / (k * share)
        sine2 = t * (2.0 - t)
        if sample_uniform(stream) >= 1.0 - share * sine2 / (1.0 + share * share):
            continue
        x = kev / HC_KEV_A * math.sqrt(max(0.5 * t, 0.0))
        if sample_uniform(stream) < interpolate(incoherent_function, x / STEP_X):
            return 1.0 - t, share


@kernel()
def sample_rayleigh(kev: float, stream: NDArray[np.uint64], x2: Array, coherent: Array) -> float:
    """Sample the cosine of the scattering angle of coherent scattering.

    The squared momentum transfer is sampled from the form factors; rejection sampling applies the Thomson angular
    factor.

    Parameters
    ----------
    kev : float
        Photon energy, in keV.
    stream : (4,) uint64 array
        State of the random number generator; updated in place.
    x2 : (nodes,) float64 array, 1/angstrom2
        Squared momentum transfers.
    coherent : (nodes,) float64 array, 1/angstrom2
        Integral of the squared form factor from 0 to each node.

    Returns
    -------
    float
        Cosine of the scattering angle.
    """
    most = (kev / HC_KEV_A) ** 2
    node = max(find_first_above(x2, most), 1)
    rise = (coherent[node] - coherent[node - 1]) / (x2[node] - x2[node - 1])
    reach = coherent[node - 1] + (most - x2[node - 1]) * rise
    while True:
        value = sample_uniform(stream) * reach
        node = max(find_first_above(coherent, value), 1)
        step = coherent[node] - coherent[node - 1]
        share = (value - coherent[node - 1]) / step if step > 0.0 else 0.0
        cosine = max(1.0 - 2.0 * (x2[node - 1] + share * (x2[node] - x2[node - 1])) / most, -1.0)
        if 2.0 * sample_uniform(stream) < 1.0 + cosine * cosine:
            return cosine


@kernel_helper()
def rotate_direction(photon: Array, cosine: float, stream: NDArray[np.uint64]) -> None:
    """Rotate the direction of a photon by a scattering angle at a random azimuth.

    Parameters
    ----------
    photon : (7,) float64 array, mm and keV
        Photon whose direction is changed in place.
    cosine : float
        Cosine of the scattering angle.
    stream : (4,) uint64 array
        State of the random number generator; updated in place.
    """
    u, v, w = photon[3], photon[4], photon[5]
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    angle = 2.0 * math.pi * sample_uniform(stream)
    a, b = sine * math.cos(angle), sine * math.sin(angle)
    across = math.sqrt(u * u + v * v)
    if across > 1e-6:
        photon[3] = u * cosine + (u * w * a - v * b) / across
        photon[4] = v * cosine + (v * w * a + u * b) / across
        photon[5] = w * cosine - across * a
    else:
        photon[3], photon[4], photon[5] = a, b, math.copysign(cosine, w * cosine)
    # The direction is normalised, because rounding errors would accumulate over many interactions.
    norm = 1.0 / math.sqrt(photon[3] ** 2 + photon[4] ** 2 + photon[5] ** 2)
    photon[3:6] *= norm
