"""Alloys: formulas that read like the name of an alloy, whose numbers are percent by mass and not atoms."""

from collections.abc import Collection, Mapping

import xraylib

from ..core.checks import InputError
from ..data.tissues import Tissue
from .materials import Material, compound_of

# Elements that an alloy may hold beside its metals, and all that are no metals.
_ADDED = frozenset(("B", "C", "N", "Si"))
_NO_METALS = _ADDED | {
    *("H", "He", "O", "F", "Ne", "P", "S", "Cl", "Ar", "Ge", "As", "Se", "Br", "Kr", "Te", "I", "Xe", "At", "Rn")
}
# So near, in percent by mass, a formula has the composition of a known alloy: who wrote it counted atoms.
_SAME_PERCENT = 3.0


def alloy_mistaken_for_compound(name: str, tissues: Mapping[str, Tissue]) -> str | None:
    """Say how a formula is read and what was likely meant, where it looks like the name of an alloy by mass.

    Parameters
    ----------
    name : str
        A material, such as "Ti6Al4V@4.43".
    tissues : Mapping
        Name -> tissue or metal, among which the right material is looked for.

    Returns
    -------
    str or None
        None for what is read as it was meant: a tissue, percent by mass, a compound.
    """
    formula, at, _ = name.partition("@")
    if not at or "=" in formula:
        return None
    try:
        counts = _counts(formula)
        material = compound_of(name)
    except (ValueError, InputError):
        return None
    metals = counts.keys() - _NO_METALS
    if len(metals) < 2 or not counts.keys() - metals <= _ADDED:
        return None
    known = _nearest(counts.keys(), tissues)
    # Two metals without a number are as often a compound, such as NiTi.
    if len(metals) == 2 and known is None and all(count == 1 for count in counts.values()):
        return None
    if known is not None and _is_like(material, tissues[known]):
        return None
    read = ", ".join(f"{_symbol(z)} {100 * part:.3g}" for z, part in material.elements)
    meant = "" if known is None else f"material {known} ({_percents(tissues[known])}), or "
    return (
        f"{name} is read as numbers of atoms: {read} % by mass; an alloy is named by mass, and would attenuate "
        f"otherwise; give {meant}percent by mass, as in Ti=90,Al=6,V=4@4.43"
    )


def _counts(formula: str) -> dict[str, float]:
    """Atoms of each element by symbol; none of what is a name of NIST's list.

    raises  ValueError for what is no formula
    """
    parsed = xraylib.CompoundParser(formula)
    return {_symbol(z): float(n) for z, n in zip(parsed["Elements"], parsed["nAtoms"], strict=True)}


def _nearest(symbols: Collection[str], tissues: Mapping[str, Tissue]) -> str | None:
    """The metal of the table that has all of some elements, its own main one among them."""
    for name, tissue in tissues.items():
        parts = tissue.composition or {}
        main = max(parts, key=lambda symbol: parts[symbol], default="")
        if main in set(symbols) - _NO_METALS and set(symbols) - _ADDED <= parts.keys():
            return name
    return None


def _is_like(material: Material, tissue: Tissue) -> bool:
    """Whether a material has the composition of a metal of the table."""
    held = {_symbol(z): 100 * part for z, part in material.elements}
    parts = tissue.composition or {}
    return all(abs(held.get(symbol, 0.0) - parts.get(symbol, 0.0)) <= _SAME_PERCENT for symbol in held.keys() | parts)


def _percents(tissue: Tissue) -> str:
    return ", ".join(f"{symbol} {percent:g}" for symbol, percent in (tissue.composition or {}).items()) + " % by mass"


def _symbol(z: int) -> str:
    return str(xraylib.AtomicNumberToSymbol(z))
