"""Attenuation of tissues, metals and compounds (xraylib)."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cache
from typing import NamedTuple

import numpy as np
import xraylib

from ..core.checks import Array, InputError, require, require_choice
from ..data.tissues import Tissue

_CM_PER_MM = 0.1
_FORMULA = "a formula and a density in g/cm3, such as Ti@4.51, or percent by mass, such as Ti=90,Al=6,V=4@4.43"
# How far percentages by mass may be from 100 in all; they are brought to it.
_OFF_PERCENT = 1.0
# Californium, the last that xraylib has cross sections of.
_LAST_ELEMENT = 98


class Material(NamedTuple):
    """What attenuates: its density, and atomic number and mass fraction of each of its elements."""

    density_g_per_cm3: float
    elements: tuple[tuple[int, float], ...]


def material_of(name: str, tissues: Mapping[str, Tissue]) -> Material:
    """The material that a name stands for.

    name     a tissue or metal, a compound of NIST's list by its name, such as "Gypsum", or "FORMULA@DENSITY" in g/cm3;
             a name of NIST's too may have a density of its own, such as "Polyethylene@0.94". A formula counts atoms;
             "Ti=90,Al=6,V=4@4.43" gives percent by mass, as alloys are named
    tissues  name -> tissue or metal
    raises   InputError for what is neither
    """
    if "@" in name or name in _nist():
        return compound_of(name)
    others = ("a name of NIST's compounds (xraylib)", "FORMULA@DENSITY", "Ti=90,Al=6,V=4@4.43")
    require_choice("material", name, (*tissues, *others))
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
    """The compound of NIST's list, with a density of its own if it is given one, or of "FORMULA@DENSITY" in
    g/cm3, by atoms or by mass.

    raises  InputError for neither
    """
    formula = name.partition("@")[0]
    if formula in _nist():
        compound = xraylib.GetCompoundDataNISTByName(formula)
        density = _density(name) if "@" in name else float(compound["density"])
        return Material(density, tuple(zip(compound["Elements"], compound["massFractions"], strict=True)))
    if "=" in formula:
        return Material(_density(name), _by_mass(formula))
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


def edges_kev(materials: Iterable[Material]) -> tuple[float, ...]:
    """List the energies of the K and L absorption edges of all elements of some materials, in keV, ascending."""
    numbers = {z for material in materials for z, _ in material.elements}
    return tuple(sorted({energy for z in numbers for energy in _edges_of(z)}))


def absorbed_fraction(formula: str, mg_per_cm2: float, energies_kev: Array) -> Array:
    """(bins,)  photons that interact, other than coherently, in a layer of a compound

    energies_kev  (bins,)
    """
    compound = xraylib.CompoundParser(formula)
    parts = zip(compound["Elements"], compound["massFractions"], strict=True)
    mu = sum(w * np.array([xraylib.CS_Photo(z, e) + xraylib.CS_Compt(z, e) for e in energies_kev]) for z, w in parts)
    return 1 - np.exp(-mu * mg_per_cm2 / 1000)


@cache
def _edges_of(z: int) -> tuple[float, ...]:
    """K and L edges of an element, in keV; light elements have no L edges in xraylib's tables."""
    energies = []
    for shell in (xraylib.K_SHELL, xraylib.L1_SHELL, xraylib.L2_SHELL, xraylib.L3_SHELL):
        with suppress(ValueError):
            energies.append(float(xraylib.EdgeEnergy(z, shell)))
    return tuple(energies)


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


def _by_mass(listed: str) -> tuple[tuple[int, float], ...]:
    """Atomic numbers and mass fractions of a list such as "Ti=90,Al=6,V=4".

    raises  InputError for what is no element, an element twice, or percentages that do not add up to 100
    """
    percents: dict[int, float] = {}
    for part in listed.split(","):
        symbol, _, text = part.partition("=")
        try:
            z, percent = xraylib.SymbolToAtomicNumber(symbol.strip()), float(text)
        except ValueError:
            raise InputError(f"material must be percent by mass, such as Ti=90,Al=6,V=4@4.43, got {part!r}") from None
        require(f"percent by mass of {symbol.strip()}", percent, 0, 100, "%")
        if z in percents:
            raise InputError(f"material must name each element once, got {symbol.strip()} twice in {listed!r}")
        percents[z] = percent
    total = sum(percents.values())
    if not abs(total - 100) <= _OFF_PERCENT:
        raise InputError(f"percent by mass of {listed!r} must add up to 100, got {total:g}")
    return tuple((z, percent / total) for z, percent in percents.items() if percent > 0)


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
