"""Attenuation of tissues, metals and compounds (xraylib)."""

from collections.abc import Iterable
from functools import cache

import numpy as np
import xraylib

from ..core.checks import Array, InputError, require, require_choice
from ..data.tissues import tissues

_CM_PER_MM = 0.1
_FORMULA = "a formula and a density in g/cm3, such as Ti@4.51"


def attenuation_per_mm(material: str, energies_kev: Array) -> Array:
    """(bins,)  linear attenuation with coherent scattering, 1/mm

    material  a tissue or metal of `data/tissues.toml`, a compound of NIST's list by its name, such as "Gypsum", or
              "FORMULA@DENSITY" in g/cm3; a name too may have a density of its own, such as "Polyethylene@0.94"
    energies_kev  (bins,)
    raises    InputError for an unknown material
    """
    density, weights = _recipe(material)
    return density * _mass_attenuation(weights, energies_kev) * _CM_PER_MM


def density_g_per_cm3(material: str) -> float:
    """Density of a tissue or compound.

    raises  InputError for an unknown material
    """
    return _recipe(material)[0]


def elements(material: str) -> tuple[float, tuple[tuple[int, float], ...]]:
    """Density (g/cm3) of a tissue or compound, and atomic number and mass fraction of each of its elements.

    raises  InputError for an unknown material
    """
    return _recipe(material)


def check_materials(materials: Iterable[str]) -> None:
    """Refuse what is neither a tissue nor a compound with a density.

    raises  InputError
    """
    for material in materials:
        _recipe(material)


def absorbed_fraction(formula: str, mg_per_cm2: float, energies_kev: Array) -> Array:
    """(bins,)  photons that interact, other than coherently, in a layer of a compound

    energies_kev  (bins,)
    """
    compound = xraylib.CompoundParser(formula)
    parts = zip(compound["Elements"], compound["massFractions"], strict=True)
    mu = sum(w * np.array([xraylib.CS_Photo(z, e) + xraylib.CS_Compt(z, e) for e in energies_kev]) for z, w in parts)
    return 1 - np.exp(-mu * mg_per_cm2 / 1000)


@cache
def _recipe(material: str) -> tuple[float, tuple[tuple[int, float], ...]]:
    """Density (g/cm3) and mass fraction of each element."""
    known, name = tissues(), material.partition("@")[0]
    if name in _nist():
        compound = xraylib.GetCompoundDataNISTByName(name)
        density = _density(material) if "@" in material else compound["density"]
        return float(density), tuple(zip(compound["Elements"], compound["massFractions"], strict=True))
    if "@" in material:
        return _compound(material)
    require_choice("material", material, (*known, "a name of NIST's compounds (xraylib)", "FORMULA@DENSITY"))
    if material not in known:
        raise InputError(f"material = {material!r}; allowed: {_FORMULA}")
    tissue = known[material]
    if tissue.mix is not None:
        return _mixture(tissue.mix)
    assert tissue.composition is not None, material
    assert tissue.density is not None, material
    total = sum(tissue.composition.values())
    weights = ((xraylib.SymbolToAtomicNumber(s), w / total) for s, w in tissue.composition.items())
    return tissue.density, tuple(weights)


@cache
def _nist() -> frozenset[str]:
    return frozenset(xraylib.GetCompoundDataNISTList())


def _mixture(volumes: dict[str, float]) -> tuple[float, tuple[tuple[int, float], ...]]:
    density, masses = 0.0, dict[int, float]()
    for name, share in volumes.items():
        part_density, weights = _recipe(name)
        density += share * part_density
        for z, w in weights:
            masses[z] = masses.get(z, 0.0) + share * part_density * w
    return density, tuple((z, mass / density) for z, mass in masses.items())


def _compound(material: str) -> tuple[float, tuple[tuple[int, float], ...]]:
    try:
        parsed = xraylib.CompoundParser(material.partition("@")[0])
    except ValueError:
        raise InputError(f"material = {material!r}; allowed: {_FORMULA}") from None
    return _density(material), tuple(zip(parsed["Elements"], parsed["massFractions"], strict=True))


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
