"""Energy that a photon deposits in a scintillator layer, by Monte Carlo simulation with K fluorescence.

A photon that interacts does not always deposit its entire energy: K fluorescence photons and Compton-scattered photons
can leave the layer. The response of a layer depends only on its material, mass per area, and the photon energy. It is
stored as two ratios that are close to 1 and vary slowly, so few energies suffice.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import xraylib
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper
from ..data.array_cache import Arrays, CacheKey, load_or_make_arrays
from ..model.detector import Detector
from .materials import Material, absorbed_fraction, attenuation_per_mm, parse_compound, sum_cross_sections
from .photon_interactions import CUT_OFF_KEV, InteractionTables, make_interaction_tables, table_energies_kev
from .photon_sampling import (
    find_first_above,
    interpolate,
    rotate_direction,
    sample_compton,
    sample_rayleigh,
    sample_uniform,
)

# Largest photon energy of the response, in keV.
_MAX_KEV = 500.0
# Energy step of the interaction tables of the layer, in keV.
_STEP_KEV = 0.1
# Ratio of consecutive energies at which the response is simulated.
_ENERGY_RATIO = 1.03
# Number of photons simulated at each energy. The statistical error of the deposited energy is at most 0.1 %.
_PHOTONS = 400_000
# Seed of the random numbers. All energies use the same numbers, which makes the response smooth.
_SEED = 60
# Energy of a K edge, in keV, above which the fluorescence is followed; softer fluorescence is absorbed within 0.03 mm.
_LEAST_K_EDGE_KEV = 12.0
# Largest energy of the partial photoelectric cross sections of xraylib, in keV.
_MAX_PARTIAL_KEV = 199.0
# K lines of an element with an emission rate of more than 1 % of all K lines (Siegbahn: Ka1, Ka2, Kb1, Kb3, Kb2, Kb2).
_K_LINES = (xraylib.KL3_LINE, xraylib.KL2_LINE, xraylib.KM3_LINE, xraylib.KM2_LINE, xraylib.KN3_LINE, xraylib.KN2_LINE)
# Source files and tables whose changes invalidate the stored responses.
_SOURCES = (
    "xray/scintillator_response.py",
    "xray/photon_interactions.py",
    "xray/photon_sampling.py",
    "xray/materials.py",
)


class KShells(NamedTuple):
    """K shells of the elements of a layer whose fluorescence is followed.

    Attributes
    ----------
    chance : (elements, energies) float64 array
        Probability that a photoelectric absorption ejects a K electron of the element and emits a K line.
    line_kev : (elements, lines) float64 array
        Energies of the K lines, in keV.
    line_cdf : (elements, lines) float64 array
        Cumulative probability of the lines; the last value is 1.
    """

    chance: Array
    line_kev: Array
    line_cdf: Array


class ScintillatorResponse(NamedTuple):
    """Deposited energy of photons that interact in a layer, relative to their energy.

    Attributes
    ----------
    energies_kev : (nodes,) float64 array
        Photon energies, in keV, ascending.
    mean : (nodes,) float64 array
        Mean deposited energy divided by photon energy and by the fraction of photons that interact other than by
        coherent scattering.
    square : (nodes,) float64 array
        Mean squared deposited energy divided by squared photon energy and by the same fraction.
    """

    energies_kev: Array
    mean: Array
    square: Array


@lru_cache(maxsize=32)
def load_scintillator_response(detector: Detector) -> ScintillatorResponse:
    """Load the response of the scintillator of a detector, or simulate it.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator.

    Returns
    -------
    ScintillatorResponse
        Deposited energy relative to photon energy. If the detector neglects escape, both ratios are 1.
    """
    if detector.escape == "none" or detector.absorption == "all":
        ends = np.array([0.0, _MAX_KEV])
        return ScintillatorResponse(ends, np.ones(2), np.ones(2))
    arrays = load_or_make_arrays(
        response_name(detector), response_origin(detector), partial(simulate_response_arrays, detector)
    )
    return ScintillatorResponse(**arrays)


def compute_deposited_energy(
    detector: Detector, energies_kev: Array, secant: float = 1.0, response: ScintillatorResponse | None = None
) -> tuple[Array, Array]:
    """Compute the energy that a photon deposits in a scintillator.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator.
    energies_kev : (bins,) array, keV
        Photon energies.
    secant : float, default 1
        Path length in the scintillator divided by its thickness, at least 1. The deposited energy of a photon that
        interacts is always that of normal incidence; at secants up to 1.25, this is at most 1.2 % too high (computed).
    response : ScintillatorResponse, optional
        Response of the scintillator. The default is `load_scintillator_response`.

    Returns
    -------
    mean_kev : (bins,) float64 array
        Mean deposited energy per incident photon, in keV.
    square_kev2 : (bins,) float64 array
        Mean squared deposited energy per incident photon, in keV2.
    """
    response = response or load_scintillator_response(detector)
    interacting = compute_interacting_fraction(detector, energies_kev, secant)
    mean, square = (np.interp(energies_kev, response.energies_kev, each) for each in (response.mean, response.square))
    return interacting * energies_kev * mean, interacting * energies_kev**2 * square


def compute_interacting_fraction(detector: Detector, energies_kev: Array, secant: float = 1.0) -> Array:
    """Compute the fraction of photons that interact in a scintillator behind its cover.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator, and its cover.
    energies_kev : (bins,) array, keV
        Photon energies.
    secant : float, default 1
        Path length in the scintillator divided by its thickness, at least 1.

    Returns
    -------
    (bins,) float64 array
        Fraction from 0 to 1, without coherent scattering in the scintillator.
    """
    scintillator, cover = compute_optical_depths(detector, energies_kev)
    return np.asarray(-np.expm1(-scintillator * secant) * np.exp(-cover * secant))


def compute_optical_depths(detector: Detector, energies_kev: Array) -> tuple[Array, Array]:
    """Compute the optical depths of a scintillator and of its cover at normal incidence.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator, and its cover.
    energies_kev : (bins,) array, keV
        Photon energies.

    Returns
    -------
    scintillator : (bins,) float64 array
        Optical depth of the scintillator without coherent scattering, dimensionless; infinite for a detector that
        absorbs all photons.
    cover : (bins,) float64 array
        Optical depth of the cover, dimensionless.
    """
    if detector.absorption == "all":
        scintillator = np.full(len(energies_kev), np.inf)
    else:
        absorbed = absorbed_fraction(detector.formula, detector.mg_per_cm2, energies_kev)
        with np.errstate(divide="ignore"):
            scintillator = -np.log1p(-absorbed)
    cover = np.zeros(len(energies_kev))
    for name, mm in detector.cover:
        cover += mm * attenuation_per_mm(parse_compound(name), energies_kev)
    return scintillator, cover


def response_name(detector: Detector) -> str:
    """Return the name of the stored response of a scintillator.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator.

    Returns
    -------
    str
        Name of the file, without digest and suffix.
    """
    return f"scintillator-{detector.formula}-{detector.mg_per_cm2:.6g}"


def response_origin(detector: Detector) -> CacheKey:
    """Return the code and input on which the response of a scintillator depends.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator.

    Returns
    -------
    CacheKey
        Key of the stored response.
    """
    facts = f"{detector.formula} {detector.mg_per_cm2:.9g}".encode()
    return CacheKey(sources=_SOURCES, libraries=("xraylib", "numba"), facts=facts)


def simulate_response_arrays(detector: Detector) -> Arrays:
    """Simulate the response of a scintillator at all energies.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator.

    Returns
    -------
    mapping of str to array
        Arrays with the names and meanings of `ScintillatorResponse`.
    """
    # Only the mass per area affects the response, so all layers have a density of 1 g/cm3.
    material, thickness_mm = parse_compound(f"{detector.formula}@1.0"), detector.mg_per_cm2 / 100.0
    tables, shells, edges = make_layer_tables(material)
    energies = _response_energies_kev(edges)
    moments = np.array([simulate_deposited_energy(kev, thickness_mm, tables, shells) for kev in energies])
    interacting = absorbed_fraction(detector.formula, detector.mg_per_cm2, energies)
    mean, square = moments[:, 0] / (interacting * energies), moments[:, 1] / (interacting * energies**2)
    return {"energies_kev": energies, "mean": mean, "square": square}


def simulate_deposited_energy(
    kev: float, thickness_mm: float, tables: InteractionTables, shells: KShells, photons: int = _PHOTONS
) -> tuple[float, float]:
    """Simulate the mean and the mean square of the energy that a photon deposits in a layer at normal incidence.

    Parameters
    ----------
    kev : float
        Photon energy, in keV.
    thickness_mm : float
        Thickness of the layer, in mm.
    tables : InteractionTables
        Interaction tables of the material of the layer.
    shells : KShells
        K shells of the material.
    photons : int, default 400_000
        Number of simulated photons.

    Returns
    -------
    mean_kev : float
        Mean deposited energy per incident photon, in keV.
    square_kev2 : float
        Mean squared deposited energy per incident photon, in keV2.
    """
    stream = np.random.SeedSequence(_SEED).generate_state(4, np.uint64).astype(np.uint64)
    return _follow_in_layer(photons, stream, kev, thickness_mm, tables, shells)


@lru_cache(maxsize=4)
def make_layer_tables(material: Material) -> tuple[InteractionTables, KShells, tuple[float, ...]]:
    """Make the interaction tables of a layer, with the K shells whose fluorescence is followed.

    Parameters
    ----------
    material : Material
        Material of the layer.

    Returns
    -------
    tables : InteractionTables
        Interaction tables in steps of 0.1 keV up to 500 keV.
    shells : KShells
        K shells with an edge above 12 keV.
    edges_kev : tuple of float
        Energies of the edges of these shells, in keV.
    """
    energies = table_energies_kev(_MAX_KEV, _STEP_KEV)
    photo = {z: w * sum_cross_sections((xraylib.CS_Photo,), z, energies) for z, w in material.elements}
    total = sum(photo.values())
    chances, lines, cdfs, edges = [], [], [], []
    for z, own in photo.items():
        edge = xraylib.EdgeEnergy(z, xraylib.K_SHELL)
        if edge < _LEAST_K_EDGE_KEV:
            continue
        chances.append(own / total * _k_shell_fractions(z, energies) * xraylib.FluorYield(z, xraylib.K_SHELL))
        rates = np.array([xraylib.RadRate(z, line) for line in _K_LINES])
        lines.append([xraylib.LineEnergy(z, line) for line in _K_LINES])
        cdfs.append(np.append(np.cumsum(rates / rates.sum())[:-1], 1.0))
        edges.append(edge)
    shape = (len(edges), len(_K_LINES))
    shells = KShells(
        np.reshape(chances, (len(edges), len(energies))), np.reshape(lines, shape), np.reshape(cdfs, shape)
    )
    return make_interaction_tables((material,), _MAX_KEV, _STEP_KEV), shells, tuple(sorted(edges))


def _k_shell_fractions(z: int, energies_kev: Array) -> Array:
    """Compute the fraction (energies,) of photoelectric absorptions of an element that eject a K electron.

    The partial cross sections (Kissel) end at 200 keV, above which the fraction is kept.
    """
    fractions = np.zeros(len(energies_kev))
    for place in np.flatnonzero(energies_kev > xraylib.EdgeEnergy(z, xraylib.K_SHELL)):
        kev = min(float(energies_kev[place]), _MAX_PARTIAL_KEV)
        fractions[place] = xraylib.CS_Photo_Partial(z, xraylib.K_SHELL, kev) / xraylib.CS_Photo_Total(z, kev)
    return fractions


def _response_energies_kev(edges_kev: tuple[float, ...]) -> Array:
    """List the energies (nodes,) of a response in keV, with two table energies around each K edge."""
    count = int(np.ceil(np.log(_MAX_KEV / CUT_OFF_KEV) / np.log(_ENERGY_RATIO)))
    energies = np.geomspace(CUT_OFF_KEV, _MAX_KEV, count + 1)
    energies = np.round((energies - CUT_OFF_KEV) / _STEP_KEV) * _STEP_KEV + CUT_OFF_KEV
    steps = (np.array(edges_kev) - CUT_OFF_KEV) / _STEP_KEV
    around = np.concatenate((np.floor(steps), np.floor(steps) + 1)) * _STEP_KEV + CUT_OFF_KEV
    return np.unique(np.concatenate((energies, around)).round(6))


@kernel()
def _follow_in_layer(
    photons: int,
    stream: NDArray[np.uint64],
    kev: float,
    thickness_mm: float,
    tables: InteractionTables,
    shells: KShells,
) -> tuple[float, float]:
    """Transport photons in a layer and return the mean and the mean square of the deposited energy.

    Each photon is forced to interact; the moments are multiplied by the probability of an interaction.
    """
    photon = np.empty(7)
    mu = _attenuation_per_mm(kev, tables)
    chance = -np.expm1(-mu * thickness_mm)
    first, second = 0.0, 0.0
    for _ in range(photons):
        photon[:] = 0.0
        photon[1] = -np.log1p(-chance * sample_uniform(stream)) / mu
        photon[4], photon[6] = 1.0, kev
        deposited = 0.0
        while True:
            before = photon[6]
            absorbed = _interact_in_layer(photon, stream, tables, shells)
            if absorbed:
                deposited += before
                break
            deposited += before - photon[6]
            photon[1] -= np.log1p(-sample_uniform(stream)) / _attenuation_per_mm(photon[6], tables) * photon[4]
            if photon[1] < 0.0 or photon[1] > thickness_mm:
                break
        first += deposited
        second += deposited * deposited
    return chance * first / photons, chance * second / photons


@kernel_helper()
def _attenuation_per_mm(kev: float, tables: InteractionTables) -> float:
    """Compute the linear attenuation coefficient of a layer, in 1/mm."""
    place = (kev - CUT_OFF_KEV) / tables.step_kev
    return (
        interpolate(tables.photoelectric[0], place)
        + interpolate(tables.compton[0], place)
        + interpolate(tables.rayleigh[0], place)
    )


@kernel_helper()
def _interact_in_layer(photon: Array, stream: NDArray[np.uint64], tables: InteractionTables, shells: KShells) -> bool:
    """Sample an interaction in a layer and return True if the entire energy is deposited.

    Scattering changes the direction and energy of the photon in place. After K fluorescence, the photon is that of the
    K line, with an isotropic direction.
    """
    place = (photon[6] - CUT_OFF_KEV) / tables.step_kev
    compton, rayleigh = interpolate(tables.compton[0], place), interpolate(tables.rayleigh[0], place)
    at = sample_uniform(stream) * (compton + rayleigh + interpolate(tables.photoelectric[0], place))
    if at < compton:
        cosine, share = sample_compton(photon[6], stream, tables.incoherent_function[0])
        photon[6] *= share
        rotate_direction(photon, cosine, stream)
        return photon[6] < CUT_OFF_KEV
    if at < compton + rayleigh:
        cosine = sample_rayleigh(photon[6], stream, tables.x_squared, tables.coherent_integral[0])
        rotate_direction(photon, cosine, stream)
        return False
    at = sample_uniform(stream)
    for element in range(len(shells.chance)):
        at -= interpolate(shells.chance[element], place)
        if at < 0.0:
            line = find_first_above(shells.line_cdf[element], sample_uniform(stream))
            kev = shells.line_kev[element, line]
            if kev >= photon[6]:
                return True
            photon[6] = kev
            rotate_direction(photon, 2.0 * sample_uniform(stream) - 1.0, stream)
            return False
    return True
