"""Interaction tables of photons in matter: xraylib cross sections of free atoms, mixed by mass fraction."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xraylib

from ..core.checks import Array
from .materials import Material

# Cut-off energy below which a photon is absorbed locally, in keV; assumed.
CUT_OFF_KEV = 5.0
# Default energy step of the interaction tables, in keV; values between steps are interpolated linearly.
_STEP_KEV = 0.5
# Step of the interaction tables in momentum transfer x = sin(angle / 2) / wavelength, in 1/angstrom.
STEP_X = 0.02
# Planck constant times speed of light, in keV angstrom; wavelength = HC_KEV_A / energy.
HC_KEV_A = 12.398419843


class InteractionTables(NamedTuple):
    """Interaction tables of several materials.

    Energies start at the cut-off of 5 keV. The momentum transfer x is in steps of 0.02 per angstrom from 0.

    Attributes
    ----------
    step_kev : float
        Energy step, in keV.
    photoelectric, compton, rayleigh : (materials, energies) float64 array
        Linear attenuation coefficient of each interaction, in 1/mm.
    incoherent_function : (materials, x) float64 array
        Incoherent scattering function divided by the number of electrons, from 0 to 1, at each momentum transfer x.
    x_squared : (nodes,) float64 array
        Squared momentum transfers at which `coherent_integral` is tabulated, in 1/angstrom2.
    coherent_integral : (materials, nodes) float64 array
        Integral of the squared form factor over the squared momentum transfer, from 0 to each node.
    """

    step_kev: float
    photoelectric: Array
    compton: Array
    rayleigh: Array
    incoherent_function: Array
    x_squared: Array
    coherent_integral: Array


@lru_cache(maxsize=8)
def make_interaction_tables(
    materials: tuple[Material, ...], max_kev: float, step_kev: float = _STEP_KEV
) -> InteractionTables:
    """Make the interaction tables of several materials.

    Parameters
    ----------
    materials : tuple of Material
        Materials in the order of their numbers.
    max_kev : float
        Largest photon energy, in keV.
    step_kev : float, default 0.5
        Energy step, in keV.

    Returns
    -------
    InteractionTables
        Interaction tables from the cut-off energy to the largest energy.

    Notes
    -----
    Compton scattering assumes free electrons at rest, without Doppler broadening. The angular distribution of Compton
    scattering is weighted with the incoherent scattering function. Coherent scattering assumes free atoms, without
    interference between molecules.
    """
    energies = table_energies_kev(max_kev, step_kev)
    most_x = energies[-1] / HC_KEV_A
    steps = int(np.ceil(most_x / STEP_X)) + 1
    x = np.linspace(0.0, steps * STEP_X, steps + 1)
    nodes = np.concatenate(([0.0], np.geomspace(1e-3, most_x, 400)))
    photo, compton, rayleigh = (
        np.array([0.1 * rho * _mixture_cross_sections(kind, parts, energies) for rho, parts in materials])
        for kind in ("Photo", "Compt", "Rayl")
    )
    return InteractionTables(
        step_kev=step_kev,
        photoelectric=photo,
        compton=compton,
        rayleigh=rayleigh,
        incoherent_function=np.array([_incoherent_function(parts, x) for _, parts in materials]),
        x_squared=nodes**2,
        coherent_integral=np.array([_coherent_integral(parts, nodes) for _, parts in materials]),
    )


def table_energies_kev(max_kev: float, step_kev: float = _STEP_KEV) -> Array:
    """List the energies of interaction tables.

    Parameters
    ----------
    max_kev : float
        Largest photon energy, in keV.
    step_kev : float, default 0.5
        Energy step, in keV.

    Returns
    -------
    (energies,) float64 array
        Energies from the cut-off of 5 keV to at least one step above `max_kev`, in keV.
    """
    steps = int(np.ceil((max_kev - CUT_OFF_KEV) / step_kev)) + 1
    return np.linspace(CUT_OFF_KEV, CUT_OFF_KEV + steps * step_kev, steps + 1)


def _mixture_cross_sections(kind: str, parts: tuple[tuple[int, float], ...], energies: Array) -> Array:
    """Compute the cross section of a mixture (energies,), in cm2/g."""
    section = getattr(xraylib, f"CS_{kind}")
    return np.sum([w * np.array([section(z, float(e)) for e in energies]) for z, w in parts], axis=0)


def _incoherent_function(parts: tuple[tuple[int, float], ...], x: Array) -> Array:
    """Compute the incoherent scattering function per electron of a mixture at x (nodes,) 1/angstrom, from 0 to 1."""
    electrons = sum(w * z / xraylib.AtomicWeight(z) for z, w in parts)
    # xraylib has no value at x = 0, where the incoherent scattering function is 0.
    scattering = sum(
        w / xraylib.AtomicWeight(z) * np.array([0.0, *(xraylib.SF_Compt(z, float(v)) for v in x[1:])]) for z, w in parts
    )
    return np.asarray(np.clip(scattering / electrons, 0, 1))


def _coherent_integral(parts: tuple[tuple[int, float], ...], x: Array) -> Array:
    """Integrate the squared form factor of a mixture over squared momentum transfer, from 0 to each node x (nodes,)."""
    squares = sum(
        w / xraylib.AtomicWeight(z) * np.array([xraylib.FF_Rayl(z, float(v)) for v in x]) ** 2 for z, w in parts
    )
    pieces = np.diff(x**2) * (squares[1:] + squares[:-1]) / 2
    return np.concatenate(([0.0], np.cumsum(pieces)))
