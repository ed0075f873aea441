"""What photons do in matter, as tables for the Monte Carlo (xraylib: independent atoms, mixed by mass)."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xraylib

from ..core.checks import Array
from ..data.detectors import Detector
from ..xray.materials import Material, absorbed_fraction

# Below this a photon is absorbed where it is.
CUT_OFF_KEV = 5.0
# Between the nodes tables are interpolated linearly.
STEP_KEV = 0.5
STEP_X = 0.02
# keV angstrom: momentum transfer x = sin(angle / 2) / wavelength, in 1/angstrom.
HC_KEV_A = 12.398419843


class Interactions(NamedTuple):
    """Tables by material; energies in steps of 0.5 keV from the cut-off, x in steps of 0.02 per angstrom from 0.

    photo, compton, rayleigh  (materials, energies)  1/mm
    bound                     (materials, x)  incoherent scattering function over the number of electrons, 0 to 1
    x2                        (nodes,)  squares of x at which `coherent` is known
    coherent                  (materials, nodes)  integral of the squared form factor over x squared, from 0
    panel                     (energies,)  optical depth of the scintillator at normal incidence
    """

    photo: Array
    compton: Array
    rayleigh: Array
    bound: Array
    x2: Array
    coherent: Array
    panel: Array


@lru_cache(maxsize=8)
def interactions_of(materials: tuple[Material, ...], most_kev: float, detector: Detector) -> Interactions:
    """Tables for photons from the cut-off up to an energy, and of the detector that absorbs them.

    Compton scattering is on free electrons at rest, its angles weighted with the incoherent scattering function (no
    Doppler broadening); coherent scattering is by free atoms, without interference between molecules. The energy of a
    photoelectric absorption stays where it is: no fluorescence.
    """
    steps = int(np.ceil((most_kev - CUT_OFF_KEV) / STEP_KEV)) + 1
    energies = np.linspace(CUT_OFF_KEV, CUT_OFF_KEV + steps * STEP_KEV, steps + 1)
    most_x = energies[-1] / HC_KEV_A
    steps = int(np.ceil(most_x / STEP_X)) + 1
    x = np.linspace(0.0, steps * STEP_X, steps + 1)
    nodes = np.concatenate(([0.0], np.geomspace(1e-3, most_x, 400)))
    photo, compton, rayleigh = (
        np.array([0.1 * rho * _by_energy(kind, parts, energies) for rho, parts in materials])
        for kind in ("Photo", "Compt", "Rayl")
    )
    absorbed = absorbed_fraction(detector.formula, detector.mg_per_cm2, energies)
    return Interactions(
        photo=photo,
        compton=compton,
        rayleigh=rayleigh,
        bound=np.array([_bound(parts, x) for _, parts in materials]),
        x2=nodes**2,
        coherent=np.array([_coherent(parts, nodes) for _, parts in materials]),
        # A layer that lets nothing through has an optical depth of 28, which says the same to a double.
        panel=-np.log1p(-np.minimum(absorbed, 1 - 1e-12)),
    )


def _by_energy(kind: str, parts: tuple[tuple[int, float], ...], energies: Array) -> Array:
    """(energies,)  cross section of a mixture, cm2/g"""
    section = getattr(xraylib, f"CS_{kind}")
    return np.sum([w * np.array([section(z, float(e)) for e in energies]) for z, w in parts], axis=0)


def _bound(parts: tuple[tuple[int, float], ...], x: Array) -> Array:
    electrons = sum(w * z / xraylib.AtomicWeight(z) for z, w in parts)
    # At x = 0, where xraylib has no value, nothing scatters.
    scattering = sum(
        w / xraylib.AtomicWeight(z) * np.array([0.0, *(xraylib.SF_Compt(z, float(v)) for v in x[1:])]) for z, w in parts
    )
    return np.asarray(np.clip(scattering / electrons, 0, 1))


def _coherent(parts: tuple[tuple[int, float], ...], x: Array) -> Array:
    squares = sum(
        w / xraylib.AtomicWeight(z) * np.array([xraylib.FF_Rayl(z, float(v)) for v in x]) ** 2 for z, w in parts
    )
    pieces = np.diff(x**2) * (squares[1:] + squares[:-1]) / 2
    return np.concatenate(([0.0], np.cumsum(pieces)))
