"""Compiled transport of individual photons through voxels.

A photon is an array (7,): position x, y, z in mm, direction u, v, w, and energy in keV.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper
from .photon_interactions import (
    CUT_OFF_KEV,
    HC_KEV_A,
    STEP_KEV,
    STEP_X,
    InteractionTables,
)

# Rest energy of the electron, in keV.
_ELECTRON_KEV = 510.99895
# Index of the emitted energy in the energy balance of a photon batch.
EMITTED = 0
# Index of the energy absorbed in the scene, in the energy balance of a photon batch.
ABSORBED = 1
# Index of the energy incident on the detector, in the energy balance of a photon batch.
ON_FIELD = 2
# Index of the energy that misses the detector, in the energy balance of a photon batch.
PAST = 3


class TransportSetup(NamedTuple):
    """Source, voxels and detector of the photon transport.

    Attributes
    ----------
    source : (3,) float64 array
        Position of the source, in mm.
    detector_y_mm : float
        y coordinate of the detector plane, in mm.
    window : (4,) float64 array
        Target area on the detector plane for emitted photons: x min, x max, z min, z max, in mm.
    field : (5,) float64 array
        Bounds of the detector (x min, x max, z min, z max) and side length of a tally cell, in mm.
    energies : (bins,) float64 array
        Photon energies, in keV.
    energy_cdf : (bins,) float64 array
        Cumulative probability of the sampled energies; the last value is 1.
    weights : (bins,) float64 array
        Statistical weight of one sampled photon of each energy, in photons per mm2 at 1 m.
    material : (x, y, z) uint8 array
        Material number of each voxel.
    origin : (3,) float64 array
        Lower corner of the voxel grid, in mm.
    size : (3,) float64 array
        Size of a voxel, in mm.
    """

    source: Array
    detector_y_mm: float
    window: Array
    field: Array
    energies: Array
    energy_cdf: Array
    weights: Array
    material: NDArray[np.uint8]
    origin: Array
    size: Array


@kernel()
def follow_photons(
    photons: int,
    stream: NDArray[np.uint64],
    setup: TransportSetup,
    tables: InteractionTables,
    counts: Array,
    energy: Array,
) -> None:
    """Transport photons until absorption or exit from the scene, and add up the deposited energy.

    Parameters
    ----------
    photons : int
        Number of photons.
    stream : (4,) uint64 array
        State of the random number generator, not all zero; updated in place.
    setup : TransportSetup
        Source, voxels and detector.
    tables : InteractionTables
        Interaction tables of the materials.
    counts : (2, rows, cols) float64 array, keV
        Energy absorbed by the scintillator, multiplied by the photon weight, for unscattered and scattered photons;
        updated in place.
    energy : (4,) float64 array, keV
        Energy multiplied by photon weight: emitted, absorbed in the scene, incident on the detector, missing the
        detector; updated in place.
    """
    photon, mu = np.empty(7), np.empty(len(tables.photoelectric))
    for _ in range(photons):
        weight = _emit_photon(photon, stream, setup)
        energy[EMITTED] += weight * photon[6]
        scattered, known = 0, -1.0
        _move_to_voxels(photon, setup)
        while True:
            if known != photon[6]:
                known, most = photon[6], _fill_attenuation(photon[6], tables, mu)
            material = _move_to_interaction(photon, stream, setup, mu, most)
            if material < 0:
                _tally_photon(photon, weight, scattered, setup, tables, counts, energy)
                break
            before = photon[6]
            scattered = 1
            if _interact(photon, stream, material, mu[material], tables):
                energy[ABSORBED] += weight * before
                break
            energy[ABSORBED] += weight * (before - photon[6])


@kernel_helper(inline="always")
def _sample_uniform(s: NDArray[np.uint64]) -> float:
    """Sample a uniform number in [0, 1) with xoshiro256++ (Blackman and Vigna 2019)."""
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
def _find_first_above(values: Array, threshold: float) -> int:
    """Return the index of the first ascending value above a threshold, or the last index if no value is above it."""
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        if values[middle] > threshold:
            high = middle
        else:
            low = middle + 1
    return low


@kernel_helper()
def _emit_photon(photon: Array, stream: NDArray[np.uint64], setup: TransportSetup) -> float:
    """Emit a photon from the source towards a point sampled uniformly in the window; return the photon weight."""
    x = setup.window[0] + _sample_uniform(stream) * (setup.window[1] - setup.window[0]) - setup.source[0]
    z = setup.window[2] + _sample_uniform(stream) * (setup.window[3] - setup.window[2]) - setup.source[2]
    y = setup.detector_y_mm - setup.source[1]
    far = math.sqrt(x * x + y * y + z * z)
    photon[:3] = setup.source
    photon[3], photon[4], photon[5] = x / far, y / far, z / far
    chosen = _find_first_above(setup.energy_cdf, _sample_uniform(stream))
    photon[6] = setup.energies[chosen]
    # The weight follows the inverse-square law, relative to 1 m, and the cosine of the angle of incidence.
    return setup.weights[chosen] * 1e6 / (far * far) * y / far


@kernel_helper()
def _move_to_voxels(photon: Array, setup: TransportSetup) -> None:
    """Move a photon from the source to its entry point into the voxel grid, if its ray hits the grid."""
    near, far = 0.0, np.inf
    for axis in range(3):
        low = setup.origin[axis] - photon[axis]
        high = low + setup.material.shape[axis] * setup.size[axis]
        if photon[3 + axis] == 0.0:
            if low > 0.0 or high <= 0.0:
                return
            continue
        one, other = low / photon[3 + axis], high / photon[3 + axis]
        near, far = max(near, min(one, other)), min(far, max(one, other))
    if near < far:
        # The photon is placed 0.001 mm inside the grid, because a rounding error could place it outside.
        for axis in range(3):
            photon[axis] += (near + 1e-3) * photon[3 + axis]


@kernel_helper(inline="always")
def _interpolate(table: Array, place: float) -> float:
    """Interpolate a table linearly at a fractional index."""
    node = min(int(place), len(table) - 2)
    return table[node] + (place - node) * (table[node + 1] - table[node])


@kernel_helper()
def _fill_attenuation(kev: float, tables: InteractionTables, mu: Array) -> float:
    """Fill `mu` (materials,) with attenuation coefficients at an energy, in 1/mm; return the largest coefficient."""
    most, place = 0.0, (kev - CUT_OFF_KEV) / STEP_KEV
    for m in range(len(mu)):
        mu[m] = (
            _interpolate(tables.photoelectric[m], place)
            + _interpolate(tables.compton[m], place)
            + _interpolate(tables.rayleigh[m], place)
        )
        most = max(most, mu[m])
    return most


@kernel_helper()
def _move_to_interaction(
    photon: Array, stream: NDArray[np.uint64], setup: TransportSetup, mu: Array, max_mu: float
) -> int:
    """Move a photon to its next interaction (delta tracking, Woodcock 1965).

    Returns the material number at the interaction, or -1 if the photon has left the grid.
    """
    shape, origin, size = setup.material.shape, setup.origin, setup.size
    while True:
        x = math.floor((photon[0] - origin[0]) / size[0])
        y = math.floor((photon[1] - origin[1]) / size[1])
        z = math.floor((photon[2] - origin[2]) / size[2])
        if x < 0 or y < 0 or z < 0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
            return -1
        length = -math.log(1.0 - _sample_uniform(stream)) / max_mu
        photon[0] += length * photon[3]
        photon[1] += length * photon[4]
        photon[2] += length * photon[5]
        x = math.floor((photon[0] - origin[0]) / size[0])
        y = math.floor((photon[1] - origin[1]) / size[1])
        z = math.floor((photon[2] - origin[2]) / size[2])
        if x < 0 or y < 0 or z < 0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
            return -1
        material = setup.material[x, y, z]
        if _sample_uniform(stream) * max_mu < mu[material]:
            return int(material)


@kernel_helper()
def _interact(photon: Array, stream: NDArray[np.uint64], material: int, mu: float, tables: InteractionTables) -> bool:
    """Sample an interaction and return True if it absorbs the photon.

    Scattering changes the direction of the photon in place, and Compton scattering also its energy.
    """
    place = (photon[6] - CUT_OFF_KEV) / STEP_KEV
    at = _sample_uniform(stream) * mu
    compton = _interpolate(tables.compton[material], place)
    rayleigh = _interpolate(tables.rayleigh[material], place)
    if at < compton:
        cosine, share = _sample_compton(photon[6], stream, tables.incoherent_function[material])
        photon[6] *= share
        _rotate_direction(photon, cosine, stream)
        return photon[6] < CUT_OFF_KEV
    if at < compton + rayleigh:
        _rotate_direction(
            photon, _sample_rayleigh(photon[6], stream, tables.x_squared, tables.coherent_integral[material]), stream
        )
        return False
    return True


@kernel()
def _sample_compton(kev: float, stream: NDArray[np.uint64], incoherent_function: Array) -> tuple[float, float]:
    """Sample the cosine of the scattering angle and the remaining energy fraction of Compton scattering.

    The Klein-Nishina formula is sampled by composition and rejection (Butcher and Messel 1960).
    """
    k = kev / _ELECTRON_KEV
    least = 1.0 / (1.0 + 2.0 * k)
    one, two = -math.log(least), 0.5 * (1.0 - least * least)
    while True:
        if _sample_uniform(stream) * (one + two) < one:
            share = math.exp(-one * _sample_uniform(stream))
        else:
            share = math.sqrt(least * least + (1.0 - least * least) * _sample_uniform(stream))
        t = (1.0 - share) / (k * share)
        sine2 = t * (2.0 - t)
        if _sample_uniform(stream) >= 1.0 - share * sine2 / (1.0 + share * share):
            continue
        x = kev / HC_KEV_A * math.sqrt(max(0.5 * t, 0.0))
        if _sample_uniform(stream) < _interpolate(incoherent_function, x / STEP_X):
            return 1.0 - t, share


@kernel()
def _sample_rayleigh(kev: float, stream: NDArray[np.uint64], x2: Array, coherent: Array) -> float:
    """Sample the cosine of the scattering angle of coherent scattering.

    The squared momentum transfer is sampled from the form factors; rejection sampling applies the Thomson angular
    factor.
    """
    most = (kev / HC_KEV_A) ** 2
    node = max(_find_first_above(x2, most), 1)
    rise = (coherent[node] - coherent[node - 1]) / (x2[node] - x2[node - 1])
    reach = coherent[node - 1] + (most - x2[node - 1]) * rise
    while True:
        value = _sample_uniform(stream) * reach
        node = max(_find_first_above(coherent, value), 1)
        step = coherent[node] - coherent[node - 1]
        share = (value - coherent[node - 1]) / step if step > 0.0 else 0.0
        cosine = max(1.0 - 2.0 * (x2[node - 1] + share * (x2[node] - x2[node - 1])) / most, -1.0)
        if 2.0 * _sample_uniform(stream) < 1.0 + cosine * cosine:
            return cosine


@kernel_helper()
def _rotate_direction(photon: Array, cosine: float, stream: NDArray[np.uint64]) -> None:
    """Rotate the direction of a photon by a scattering angle, specified by its cosine, at a random azimuth."""
    u, v, w = photon[3], photon[4], photon[5]
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    angle = 2.0 * math.pi * _sample_uniform(stream)
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


@kernel_helper()
def _tally_photon(
    photon: Array,
    weight: float,
    scattered: int,
    setup: TransportSetup,
    tables: InteractionTables,
    counts: Array,
    energy: Array,
) -> None:
    """Add the energy of a photon that has left the voxel grid to the detector cell that it hits, if any."""
    x0, x1, z0, z1, cell = setup.field
    if photon[4] > 0.0:
        # If the last step ends behind the detector plane, the photon is moved back to the plane (`way` is negative).
        way = (setup.detector_y_mm - photon[1]) / photon[4]
        x, z = photon[0] + way * photon[3], photon[2] + way * photon[5]
        if x0 <= x < x1 and z0 < z <= z1:
            depth = _interpolate(tables.scintillator_depth, (photon[6] - CUT_OFF_KEV) / STEP_KEV) / photon[4]
            absorbed = weight * photon[6] * (1.0 - math.exp(-depth))
            counts[scattered, int((z1 - z) / cell), int((x - x0) / cell)] += absorbed
            energy[ON_FIELD] += weight * photon[6]
            return
    energy[PAST] += weight * photon[6]
