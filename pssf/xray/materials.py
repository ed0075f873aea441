"""Attenuation of tissues, metals and compounds (cross sections from xraylib)."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import xraylib

from ..core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
)
from ..data.anatomy.tissue_table import Tissue

# Function of xraylib that maps an atomic number and an energy in keV to a cross section in cm2/g.
CrossSection = Callable[[int, float], float]
# Centimetres per millimetre.
_CM_PER_MM = 0.1
# Description of valid material names, for error messages.
_FORMULA_HINT = "a formula and a density in g/cm3, such as Ti@4.51, or percent by mass, such as Ti=90,Al=6,V=4@4.43"
# Allowed deviation of the sum of mass percentages from 100, in percentage points; the percentages are then normalised.
_PERCENT_SUM_TOLERANCE = 1.0
# Atomic number of californium, the heaviest element with cross sections in xraylib.
_MAX_ATOMIC_NUMBER = 98


class Material(NamedTuple):
    """Attenuating material.

    Attributes
    ----------
    density_g_per_cm3 : float
        Density in g/cm3.
    elements : tuple of (int, float)
        Atomic number and mass fraction of each element.
    """

    density_g_per_cm3: float
    elements: tuple[tuple[int, float], ...]


def resolve_material(name: str, tissues: Mapping[str, Tissue]) -> Material:
    """Resolve the name of a material into its density and elements.

    Parameters
    ----------
    name : str
        A tissue or metal from the table, a compound from the NIST list such as ``"Gypsum"``, or ``"FORMULA@DENSITY"``
        in g/cm3 such as ``"Ti@4.51"``. Numbers in a formula are numbers of atoms. Alloys are specified in percent by
        mass, such as ``"Ti=90,Al=6,V=4@4.43"``. A NIST name may be followed by another density, such as
        ``"Polyethylene@0.94"``.
    tissues : mapping of str to Tissue
        Known tissues and metals.

    Returns
    -------
    Material
        Density and mass fractions of the elements.

    Raises
    ------
    InputError
        The name has none of the forms that are listed for `name`.
    """
    if "@" in name or name in _nist_compound_names():
        return parse_compound(name)
    others = ("the name of a NIST compound (xraylib)", "FORMULA@DENSITY", "Ti=90,Al=6,V=4@4.43")
    require_choice("material", name, (*tissues, *others))
    if name not in tissues:
        raise InputError(f"material must be {_FORMULA_HINT}, got {name!r}")
    tissue = tissues[name]
    if tissue.mix is not None:
        return _mix_tissues(tissue.mix, tissues)
    assert tissue.composition is not None, name
    assert tissue.density is not None, name
    total = sum(tissue.composition.values())
    weights = ((xraylib.SymbolToAtomicNumber(s), w / total) for s, w in tissue.composition.items())
    return Material(tissue.density, tuple(weights))


def parse_compound(name: str) -> Material:
    """Parse a compound of the NIST list, or a formula or alloy with a density.

    Parameters
    ----------
    name : str
        NIST name with or without a density, or formula or composition in percent by mass with a density in g/cm3.

    Returns
    -------
    Material
        Density and mass fractions of the elements.

    Raises
    ------
    InputError
        The name is neither a NIST name nor a composition with a density, or contains an element heavier than
        californium.
    """
    formula = name.partition("@")[0]
    if formula in _nist_compound_names():
        compound = xraylib.GetCompoundDataNISTByName(formula)
        density = _parse_density(name) if "@" in name else float(compound["density"])
        return Material(density, tuple(zip(compound["Elements"], compound["massFractions"], strict=True)))
    if "=" in formula:
        return Material(_parse_density(name), _parse_mass_percents(formula))
    try:
        parsed = xraylib.CompoundParser(formula)
    except ValueError:
        raise InputError(f"material must be {_FORMULA_HINT}, got {name!r}") from None
    beyond = [xraylib.AtomicNumberToSymbol(z) for z in parsed["Elements"] if z > _MAX_ATOMIC_NUMBER]
    if beyond:
        raise InputError(
            f"material {name!r} must contain only elements up to Cf ({_MAX_ATOMIC_NUMBER}), got {', '.join(beyond)}: "
            "xraylib has no cross sections for heavier elements"
        )
    return Material(_parse_density(name), tuple(zip(parsed["Elements"], parsed["massFractions"], strict=True)))


def attenuation_per_mm(material: Material, energies_kev: Array) -> Array:
    """Compute the linear attenuation coefficient, including coherent scattering.

    Parameters
    ----------
    material : Material
        Density and elements.
    energies_kev : (bins,) array, keV
        Photon energies.

    Returns
    -------
    (bins,) float64 array
        Linear attenuation coefficients, in 1/mm.
    """
    return material.density_g_per_cm3 * _mass_attenuation_cm2_per_g(material.elements, energies_kev) * _CM_PER_MM


def absorption_edges_kev(materials: Iterable[Material]) -> tuple[float, ...]:
    """List the K and L absorption edges of all elements in a set of materials.

    Parameters
    ----------
    materials : iterable of Material
        Materials with their elements.

    Returns
    -------
    tuple of float
        Energies in keV, in ascending order.
    """
    numbers = {z for material in materials for z, _ in material.elements}
    return tuple(sorted({energy for z in numbers for energy in _element_edges_kev(z)}))


def absorbed_fraction(formula: str, mg_per_cm2: float, energies_kev: Array) -> Array:
    """Compute the fraction of photons that interact in a layer of a compound, excluding coherent scattering.

    Parameters
    ----------
    formula : str
        Chemical formula of the layer.
    mg_per_cm2 : float
        Mass per area of the layer, in mg/cm2.
    energies_kev : (bins,) array, keV
        Photon energies.

    Returns
    -------
    (bins,) float64 array
        Fraction from 0 to 1.
    """
    compound = xraylib.CompoundParser(formula)
    parts = zip(compound["Elements"], compound["massFractions"], strict=True)
    mu = sum(w * sum_cross_sections((xraylib.CS_Photo, xraylib.CS_Compt), z, energies_kev) for z, w in parts)
    return 1 - np.exp(-mu * mg_per_cm2 / 1000)


def sum_cross_sections(interactions: tuple[CrossSection, ...], z: int, energies_kev: Array) -> Array:
    """Sum the cross sections of an element over several interactions.

    Parameters
    ----------
    interactions : tuple of callable
        Functions of xraylib that map an atomic number and an energy in keV to a cross section in cm2/g.
    z : int
        Atomic number.
    energies_kev : (bins,) array, keV
        Photon energies.

    Returns
    -------
    (bins,) float64 array
        Cross sections, in cm2/g. The array is read-only, because an image needs the same one a dozen times and further
        calls return it again.
    """
    return _compute_cross_sections(interactions, z, np.asarray(energies_kev, np.float64).tobytes())


@cache
def _element_edges_kev(z: int) -> tuple[float, ...]:
    """List the K and L edges of an element in keV; xraylib has no L edges for light elements."""
    energies = []
    for shell in (xraylib.K_SHELL, xraylib.L1_SHELL, xraylib.L2_SHELL, xraylib.L3_SHELL):
        with suppress(ValueError):
            energies.append(float(xraylib.EdgeEnergy(z, shell)))
    return tuple(energies)


@cache
def _nist_compound_names() -> frozenset[str]:
    """Return the names of the NIST compounds in xraylib."""
    return frozenset(xraylib.GetCompoundDataNISTList())


def _mix_tissues(volumes: Mapping[str, float], tissues: Mapping[str, Tissue]) -> Material:
    """Mix tissues by volume fraction."""
    density, masses = 0.0, dict[int, float]()
    for name, share in volumes.items():
        part = resolve_material(name, tissues)
        density += share * part.density_g_per_cm3
        for z, w in part.elements:
            masses[z] = masses.get(z, 0.0) + share * part.density_g_per_cm3 * w
    return Material(density, tuple((z, mass / density) for z, mass in masses.items()))


def _parse_mass_percents(listed: str) -> tuple[tuple[int, float], ...]:
    """Parse a list such as ``"Ti=90,Al=6,V=4"`` into atomic numbers and mass fractions.

    Raise InputError for an unknown element, a repeated element, or percentages that do not add up to 100.
    """
    percents: dict[int, float] = {}
    for part in listed.split(","):
        symbol, _, text = part.partition("=")
        try:
            z, percent = xraylib.SymbolToAtomicNumber(symbol.strip()), float(text)
        except ValueError:
            raise InputError(f"material must be percent by mass, such as Ti=90,Al=6,V=4@4.43, got {part!r}") from None
        require_in_range(f"percent by mass of {symbol.strip()}", percent, 0, 100, "%")
        if z in percents:
            raise InputError(f"material must name each element once, got {symbol.strip()} twice in {listed!r}")
        percents[z] = percent
    total = sum(percents.values())
    if not abs(total - 100) <= _PERCENT_SUM_TOLERANCE:
        raise InputError(f"percent by mass of {listed!r} must add up to 100, got {total:g}")
    return tuple((z, percent / total) for z, percent in percents.items() if percent > 0)


def _parse_density(material: str) -> float:
    """Parse the density after the @ of a material name, in g/cm3."""
    name, _, text = material.partition("@")
    try:
        density = float(text)
    except ValueError:
        raise InputError(f"material must be {_FORMULA_HINT}, got {material!r}") from None
    require_in_range(f"density of {name}", density, 1e-6, 30, "g/cm3")
    return density


def _mass_attenuation_cm2_per_g(weights: tuple[tuple[int, float], ...], energies_kev: Array) -> Array:
    """Compute the mass attenuation coefficient (bins,) of a mixture of elements, in cm2/g."""
    return np.sum([w * sum_cross_sections((xraylib.CS_Total,), z, energies_kev) for z, w in weights], axis=0)


@lru_cache(maxsize=2048)
def _compute_cross_sections(interactions: tuple[CrossSection, ...], z: int, energies_kev: bytes) -> Array:
    """Compute cross sections of an element in cm2/g at energies given as float64 bytes; results are cached."""
    energies = np.frombuffer(energies_kev).tolist()
    sections = np.array([sum(function(z, energy) for function in interactions) for energy in energies])
    sections.flags.writeable = False
    return sections
