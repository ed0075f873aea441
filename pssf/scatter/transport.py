"""Photons followed one by one through voxels, compiled. Compiled functions that call each other stand in one module.

A photon is an array: place x, y, z (mm), direction u, v, w, energy (keV).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel
from .interactions import CUT_OFF_KEV, HC_KEV_A, STEP_KEV, STEP_X, Interactions

_ELECTRON_KEV = 510.99895
# Where the energy of a batch goes.
EMITTED, ABSORBED, ON_FIELD, PAST = range(4)


class Setting(NamedTuple):
    """Where photons start, what they cross and where they are counted.

    source    (3,)  mm
    plane     y of the detector, mm
    window    (4,)  x from, x to, z from, z to of the part of the detector that photons are aimed at, mm
    field     (5,)  x from, x to, z from, z to of the detector, and the side of a cell in which is counted, mm
    energies  (bins,)  keV
    chosen    (bins,)  cumulative probability that a photon is given an energy; the last is 1
    weights   (bins,)  photons a square millimetre at 1 m that one photon of an energy stands for
    material  (x, y, z) uint8  of a voxel
    origin    (3,)  of the voxels, mm
    size      (3,)  of a voxel, mm
    """

    source: Array
    plane: float
    window: Array
    field: Array
    energies: Array
    chosen: Array
    weights: Array
    material: NDArray[np.uint8]
    origin: Array
    size: Array


@kernel()
def follow(
    photons: int, stream: NDArray[np.uint64], where: Setting, what: Interactions, counts: Array, energy: Array
) -> None:
    """Follow photons until each is absorbed or gone, and add up what they leave.

    stream  (4,)  state of the random numbers, not all zero
    counts  (2, rows, cols)  energy absorbed by the scintillator, keV times weight: of unscattered photons, of scattered
    energy  (4,)  keV times weight: emitted, absorbed, fallen on the field, gone past it
    """
    photon, mu = np.empty(7), np.empty(len(what.photo))
    for _ in range(photons):
        weight = _emit(photon, stream, where)
        energy[EMITTED] += weight * photon[6]
        scattered, known = 0, -1.0
        _enter(photon, where)
        while True:
            if known != photon[6]:
                known, most = photon[6], _attenuation(photon[6], what, mu)
            material = _fly(photon, stream, where, mu, most)
            if material < 0:
                _count(photon, weight, scattered, where, what, counts, energy)
                break
            before = photon[6]
            scattered = 1
            if _absorbed(photon, stream, material, mu[material], what):
                energy[ABSORBED] += weight * before
                break
            energy[ABSORBED] += weight * (before - photon[6])


@callee(inline="always")
def _random(s: NDArray[np.uint64]) -> float:
    """Uniform in [0, 1): xoshiro256++ (Blackman and Vigna 2019)."""
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


@callee(inline="always")
def _above(values: Array, at: float) -> int:
    """The first of growing values that is above a number, or the last."""
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        if values[middle] > at:
            high = middle
        else:
            low = middle + 1
    return low


@callee()
def _emit(photon: Array, stream: NDArray[np.uint64], where: Setting) -> float:
    """Start a photon at the source, aimed at a place drawn evenly in the window; returns its weight."""
    x = where.window[0] + _random(stream) * (where.window[1] - where.window[0]) - where.source[0]
    z = where.window[2] + _random(stream) * (where.window[3] - where.window[2]) - where.source[2]
    y = where.plane - where.source[1]
    far = math.sqrt(x * x + y * y + z * z)
    photon[:3] = where.source
    photon[3], photon[4], photon[5] = x / far, y / far, z / far
    chosen = _above(where.chosen, _random(stream))
    photon[6] = where.energies[chosen]
    # Inverse square from 1 m, and the detector seen at a slant.
    return where.weights[chosen] * 1e6 / (far * far) * y / far


@callee()
def _enter(photon: Array, where: Setting) -> None:
    """Move a photon from the source to where it enters the grid, if it does."""
    near, far = 0.0, np.inf
    for axis in range(3):
        low = where.origin[axis] - photon[axis]
        high = low + where.material.shape[axis] * where.size[axis]
        if photon[3 + axis] == 0.0:
            if low > 0.0 or high <= 0.0:
                return
            continue
        one, other = low / photon[3 + axis], high / photon[3 + axis]
        near, far = max(near, min(one, other)), min(far, max(one, other))
    if near < far:
        # A thousandth of a millimetre inside, so that rounding leaves it inside.
        for axis in range(3):
            photon[axis] += (near + 1e-3) * photon[3 + axis]


@callee(inline="always")
def _between(table: Array, place: float) -> float:
    node = min(int(place), len(table) - 2)
    return table[node] + (place - node) * (table[node + 1] - table[node])


@callee()
def _attenuation(kev: float, what: Interactions, mu: Array) -> float:
    """Fill `mu` (materials,) in 1/mm at an energy; returns the largest."""
    most, place = 0.0, (kev - CUT_OFF_KEV) / STEP_KEV
    for m in range(len(mu)):
        mu[m] = _between(what.photo[m], place) + _between(what.compton[m], place) + _between(what.rayleigh[m], place)
        most = max(most, mu[m])
    return most


@callee()
def _fly(photon: Array, stream: NDArray[np.uint64], where: Setting, mu: Array, most: float) -> int:
    """Move a photon to its next interaction (delta tracking, Woodcock 1965); returns the material, -1 outside."""
    shape, origin, size = where.material.shape, where.origin, where.size
    while True:
        x = math.floor((photon[0] - origin[0]) / size[0])
        y = math.floor((photon[1] - origin[1]) / size[1])
        z = math.floor((photon[2] - origin[2]) / size[2])
        if x < 0 or y < 0 or z < 0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
            return -1
        length = -math.log(1.0 - _random(stream)) / most
        photon[0] += length * photon[3]
        photon[1] += length * photon[4]
        photon[2] += length * photon[5]
        x = math.floor((photon[0] - origin[0]) / size[0])
        y = math.floor((photon[1] - origin[1]) / size[1])
        z = math.floor((photon[2] - origin[2]) / size[2])
        if x < 0 or y < 0 or z < 0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
            return -1
        material = where.material[x, y, z]
        if _random(stream) * most < mu[material]:
            return int(material)


@callee()
def _absorbed(photon: Array, stream: NDArray[np.uint64], material: int, mu: float, what: Interactions) -> bool:
    """One interaction: whether it ends the photon, which has else a new direction, and after Compton a new energy."""
    place = (photon[6] - CUT_OFF_KEV) / STEP_KEV
    at = _random(stream) * mu
    compton = _between(what.compton[material], place)
    rayleigh = _between(what.rayleigh[material], place)
    if at < compton:
        cosine, share = _compton(photon[6], stream, what.bound[material])
        photon[6] *= share
        _turn(photon, cosine, stream)
        return photon[6] < CUT_OFF_KEV
    if at < compton + rayleigh:
        _turn(photon, _rayleigh(photon[6], stream, what.x2, what.coherent[material]), stream)
        return False
    return True


@kernel()
def _compton(kev: float, stream: NDArray[np.uint64], bound: Array) -> tuple[float, float]:
    """Cosine and energy share after Compton: Klein-Nishina by composition and rejection (Butcher and Messel 1960)."""
    k = kev / _ELECTRON_KEV
    least = 1.0 / (1.0 + 2.0 * k)
    one, two = -math.log(least), 0.5 * (1.0 - least * least)
    while True:
        if _random(stream) * (one + two) < one:
            share = math.exp(-one * _random(stream))
        else:
            share = math.sqrt(least * least + (1.0 - least * least) * _random(stream))
        t = (1.0 - share) / (k * share)
        sine2 = t * (2.0 - t)
        if _random(stream) >= 1.0 - share * sine2 / (1.0 + share * share):
            continue
        x = kev / HC_KEV_A * math.sqrt(max(0.5 * t, 0.0))
        if _random(stream) < _between(bound, x / STEP_X):
            return 1.0 - t, share


@kernel()
def _rayleigh(kev: float, stream: NDArray[np.uint64], x2: Array, coherent: Array) -> float:
    """Cosine after coherent scattering: x squared from the form factors, then Thomson's angles by rejection."""
    most = (kev / HC_KEV_A) ** 2
    node = max(_above(x2, most), 1)
    rise = (coherent[node] - coherent[node - 1]) / (x2[node] - x2[node - 1])
    reach = coherent[node - 1] + (most - x2[node - 1]) * rise
    while True:
        value = _random(stream) * reach
        node = max(_above(coherent, value), 1)
        step = coherent[node] - coherent[node - 1]
        share = (value - coherent[node - 1]) / step if step > 0.0 else 0.0
        cosine = max(1.0 - 2.0 * (x2[node - 1] + share * (x2[node] - x2[node - 1])) / most, -1.0)
        if 2.0 * _random(stream) < 1.0 + cosine * cosine:
            return cosine


@callee()
def _turn(photon: Array, cosine: float, stream: NDArray[np.uint64]) -> None:
    """Turn a photon's direction by an angle, about itself by a random one."""
    u, v, w = photon[3], photon[4], photon[5]
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    angle = 2.0 * math.pi * _random(stream)
    a, b = sine * math.cos(angle), sine * math.sin(angle)
    across = math.sqrt(u * u + v * v)
    if across > 1e-6:
        photon[3] = u * cosine + (u * w * a - v * b) / across
        photon[4] = v * cosine + (v * w * a + u * b) / across
        photon[5] = w * cosine - across * a
    else:
        photon[3], photon[4], photon[5] = a, b, math.copysign(cosine, w * cosine)
    # Kept at length 1 through any number of turns.
    norm = 1.0 / math.sqrt(photon[3] ** 2 + photon[4] ** 2 + photon[5] ** 2)
    photon[3:6] *= norm


@callee()
def _count(
    photon: Array, weight: float, scattered: int, where: Setting, what: Interactions, counts: Array, energy: Array
) -> None:
    """Add a photon that has left the grid where it meets the detector, if it does."""
    x0, x1, z0, z1, cell = where.field
    if photon[4] > 0.0:
        # One that has flown on beyond the plane, its last step being long, is taken back to it.
        way = (where.plane - photon[1]) / photon[4]
        x, z = photon[0] + way * photon[3], photon[2] + way * photon[5]
        if x0 <= x < x1 and z0 < z <= z1:
            depth = _between(what.panel, (photon[6] - CUT_OFF_KEV) / STEP_KEV) / photon[4]
            absorbed = weight * photon[6] * (1.0 - math.exp(-depth))
            counts[scattered, int((z1 - z) / cell), int((x - x0) / cell)] += absorbed
            energy[ON_FIELD] += weight * photon[6]
            return
    energy[PAST] += weight * photon[6]
