"""Attenuation of tissues, metals and compounds (xraylib)."""

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
import xraylib

from ..core.checks import Array, InputError, require, require_choice
from ..data.tissues import Tissue

_CM_PER_MM = 0.1
# Californium, the last that xraylib has cross sections of.
_LAST_ELEMENT = 98
_FORMULA = "a formula and a density in g/cm3, such as Ti@4.51"


class Material(NamedTuple):
    """What attenuates: its density, and atomic number and mass fraction of each of its elements."""

    density_g_per_cm3: float
    elements: tuple[tuple[int, float], ...]


def material_of(name: str, tissues: Mapping[str, Tissue]) -> Material:
    """The material that a name stands for.

    name     a tissue or metal, a compound of NIST's list by its name, such as "Gypsum", or "FORMULA@DENSITY" in g/cm3;
             a name of NIST's too may have a density of its own, such as "Polyethylene@0.94"
    tissues  name -> tissue or metal
    raises   InputError for what is neither
    """
    if "@" in name or name in _nist():
        return compound_of(name)
    require_choice("material", name, (*tissues, "a name of NIST's compounds (xraylib)", "FORMULA@DENSITY"))
    if name not in tissues:
        raise InputError(f"material = {name!r}; allowed: {_FORMULA}")
    tissue = tissues[name]
    if tissue.mix is not None:
        return _mixture(tissue.mix, tissues)
    assert tissue.composition is not None, name
    assert tissue.density is not None, name
    total = sum(tissue.composition.values())
    weights = ((xraylib.SymbolToAtomicNumber(s), w / total) for s, w in tissue.composition.items())
    return Material(tissue.density, tuple(weights))


def compound_of(name: str) -> Material:
    """The compound of NIST's list, with a density of its own if it is given one, or of "FORMULA@DENSITY" in g/cm3.

    raises  InputError for neither
    """
    formula = name.partition("@")[0]
    if formula in _nist():
        compound = xraylib.GetCompoundDataNISTByName(formula)
        density = _density(name) if "@" in name else float(compound["density"])
        return Material(density, tuple(zip(compound["Elements"], compound["massFractions"], strict=True)))
    try:
        parsed = xraylib.CompoundParser(formula)
    except ValueError:
        raise InputError(f"material = {name!r}; allowed: {_FORMULA}") from None
    beyond = [xraylib.AtomicNumberToSymbol(z) for z in parsed["Elements"] if z > _LAST_ELEMENT]
    if beyond:
        raise InputError(
            f"material {name!r} must be of elements up to Cf ({_LAST_ELEMENT}), got {', '.join(beyond)}: xraylib has "
            "no cross sections beyond"
        )
    return Material(_density(name), tuple(zip(parsed["Elements"], parsed["massFractions"], strict=True)))


def attenuation_per_mm(material: Material, energies_kev: Array) -> Array:
    """(bins,)  linear attenuation with coherent scattering, 1/mm

    energies_kev  (bins,)  keV
    """
    return material.density_g_per_cm3 * _mass_attenuation(material.elements, energies_kev) * _CM_PER_MM


def absorbed_fraction(formula: str, mg_per_cm2: float, energies_kev: Array) -> Array:
    """(bins,)  photons that interact, other than coherently, in a layer of a compound

    energies_kev  (bins,)
    """
    compound = xraylib.CompoundParser(formula)
    parts = zip(compound["Elements"], compound["massFractions"], strict=True)
    mu = sum(w * np.array([xraylib.CS_Photo(z, e) + xraylib.CS_Compt(z, e) for e in energies_kev]) for z, w in parts)
    return 1 - np.exp(-mu * mg_per_cm2 / 1000)


@cache
def _nist() -> frozenset[str]:
    return frozenset(xraylib.GetCompoundDataNISTList())


def _mixture(volumes: Mapping[str, float], tissues: Mapping[str, Tissue]) -> Material:
    density, masses = 0.0, dict[int, float]()
    for name, share in volumes.items():
        part = material_of(name, tissues)
        density += share * part.density_g_per_cm3
        for z, w in part.elements:
            masses[z] = masses.get(z, 0.0) + share * part.density_g_per_cm3 * w
    return Material(density, tuple((z, mass / density) for z, mass in masses.items()))


def _density(material: str) -> float:
    name, _, text = material.partition("@")
    try:
        density = float(text)
    except ValueError:
        raise InputError(f"material = {material!r}; allowed: {_FORMULA}") from None
    require(f"density of {name}", density, 1e-6, 30, "g/cm3")
    return density


def _mass_attenuation(weights: tuple[tuple[int, float], ...], energies_kev: Array) -> Array:
    return np.sum([w * np.array([xraylib.CS_Total(z, float(e)) for e in energies_kev]) for z, w in weights], axis=0)
