"""Compiled transport of individual photons through voxels.

A photon is an array (7,): position x, y, z in mm, direction u, v, w, and energy in keV.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper
from ..xray.photon_interactions import CUT_OFF_KEV, InteractionTables
from ..xray.photon_sampling import (
    find_first_above,
    interpolate,
    rotate_direction,
    sample_compton,
    sample_rayleigh,
    sample_uniform,
)

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
    scintillator_depth : (energies,) float64 array
        Optical depth of the scintillator at normal incidence, at the energies of the interaction tables, dimensionless.
    cover_depth : (energies,) float64 array
        Optical depth of the detector cover at normal incidence, at the same energies, dimensionless.
    deposited_fraction : (energies,) float64 array
        Mean deposited energy of a photon that interacts in the scintillator, divided by the photon energy.
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
    scintillator_depth: Array
    cover_depth: Array
    deposited_fraction: Array


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


@kernel_helper()
def _emit_photon(photon: Array, stream: NDArray[np.uint64], setup: TransportSetup) -> float:
    """Emit a photon from the source towards a point sampled uniformly in the window; return the photon weight."""
    x = setup.window[0] + sample_uniform(stream) * (setup.window[1] - setup.window[0]) - setup.source[0]
    z = setup.window[2] + sample_uniform(stream) * (setup.window[3] - setup.window[2]) - setup.source[2]
    y = setup.detector_y_mm - setup.source[1]
    far = math.sqrt(x * x + y * y + z * z)
    photon[:3] = setup.source
    photon[3], photon[4], photon[5] = x / far, y / far, z / far
    chosen = find_first_above(setup.energy_cdf, sample_uniform(stream))
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


@kernel_helper()
def _fill_attenuation(kev: float, tables: InteractionTables, mu: Array) -> float:
    """Fill `mu` (materials,) with attenuation coefficients at an energy, in 1/mm; return the largest coefficient."""
    most, place = 0.0, (kev - CUT_OFF_KEV) / tables.step_kev
    for m in range(len(mu)):
        mu[m] = (
            interpolate(tables.photoelectric[m], place)
            + interpolate(tables.compton[m], place)
            + interpolate(tables.rayleigh[m], place)
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
        length = -math.log(1.0 - sample_uniform(stream)) / max_mu
        photon[0] += length * photon[3]
        photon[1] += length * photon[4]
        photon[2] += length * photon[5]
        x = math.floor((photon[0] - origin[0]) / size[0])
        y = math.floor((photon[1] - origin[1]) / size[1])
        z = math.floor((photon[2] - origin[2]) / size[2])
        if x < 0 or y < 0 or z < 0 or x >= shape[0] or y >= shape[1] or z >= shape[2]:
            return -1
        material = setup.material[x, y, z]
        if sample_uniform(stream) * max_mu < mu[material]:
            return int(material)


@kernel_helper()
def _interact(photon: Array, stream: NDArray[np.uint64], material: int, mu: float, tables: InteractionTables) -> bool:
    """Sample an interaction and return True if it absorbs the photon.

    Scattering changes the direction of the photon in place, and Compton scattering also its energy.
    """
    place = (photon[6] - CUT_OFF_KEV) / tables.step_kev
    at = sample_uniform(stream) * mu
    compton = interpolate(tables.compton[material], place)
    rayleigh = interpolate(tables.rayleigh[material], place)
    if at < compton:
        cosine, share = sample_compton(photon[6], stream, tables.incoherent_function[material])
        photon[6] *= share
        rotate_direction(photon, cosine, stream)
        return photon[6] < CUT_OFF_KEV
    if at < compton + rayleigh:
        rotate_direction(
            photon, sample_rayleigh(photon[6], stream, tables.x_squared, tables.coherent_integral[material]), stream
        )
        return False
    return True


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
            place = (photon[6] - CUT_OFF_KEV) / tables.step_kev
            depth = interpolate(setup.scintillator_depth, place) / photon[4]
            share = (1.0 - math.exp(-depth)) * interpolate(setup.deposited_fraction, place)
            share *= math.exp(-interpolate(setup.cover_depth, place) / photon[4])
            absorbed = weight * photon[6] * share
            counts[scattered, int((z1 - z) / cell), int((x - x0) / cell)] += absorbed
            energy[ON_FIELD] += weight * photon[6]
            return
    energy[PAST] += weight * photon[6]
