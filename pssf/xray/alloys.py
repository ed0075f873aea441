"""Detection of formulas that are probably alloy names, in which numbers mean percent by mass and not atoms."""

from collections.abc import Collection, Mapping

import xraylib

from ..core.checks import InputError
from ..data.anatomy.tissue_table import Tissue
from .materials import Material, parse_compound

# Nonmetals that an alloy may contain.
_ALLOYED_NONMETALS = frozenset(("B", "C", "N", "Si"))
# All nonmetals.
_NONMETALS = _ALLOYED_NONMETALS | {
    *("H", "He", "O", "F", "Ne", "P", "S", "Cl", "Ar", "Ge", "As", "Se", "Br", "Kr", "Te", "I", "Xe", "At", "Rn")
}
# Tolerance of the comparison with known alloys, in percent by mass per element. A formula whose atom numbers give the
# composition of a known alloy within the tolerance is correct, and causes no warning.
_COMPOSITION_TOLERANCE_PERCENT = 3.0


def describe_alloy_misreading(name: str, tissues: Mapping[str, Tissue]) -> str | None:
    """Explain how a formula is interpreted and what the user probably meant, if the formula resembles an alloy name.

    Parameters
    ----------
    name : str
        Material name, such as ``"Ti6Al4V@4.43"``.
    tissues : mapping of str to Tissue
        Known tissues and metals, among which the intended material is searched for.

    Returns
    -------
    str or None
        Text of a warning. None if the name is unambiguous, that is, a tissue, a composition in percent by mass, or a
        compound.
    """
    formula, at, _ = name.partition("@")
    if not at or "=" in formula:
        return None
    try:
        counts = _count_atoms(formula)
        material = parse_compound(name)
    except (ValueError, InputError):
        return None
    metals = counts.keys() - _NONMETALS
    if len(metals) < 2 or not counts.keys() - metals <= _ALLOYED_NONMETALS:
        return None
    known = _find_matching_metal(counts.keys(), tissues)
    # Two metals without numbers are often the formula of a compound, such as NiTi.
    if len(metals) == 2 and known is None and all(count == 1 for count in counts.values()):
        return None
    if known is not None and _has_same_composition(material, tissues[known]):
        return None
    read = ", ".join(f"{_element_symbol(z)} {100 * part:.3g}" for z, part in material.elements)
    meant = "" if known is None else f"material {known} ({_format_composition(tissues[known])}), or "
    return (
        f"{name} is interpreted as numbers of atoms, that is {read} % by mass, but alloy names state percent by mass, "
        f"so the attenuation differs; use {meant}percent by mass, as in Ti=90,Al=6,V=4@4.43"
    )


def _count_atoms(formula: str) -> dict[str, float]:
    """Count the atoms of each element in a formula, by symbol; raise ValueError for an invalid formula."""
    parsed = xraylib.CompoundParser(formula)
    return {_element_symbol(z): float(n) for z, n in zip(parsed["Elements"], parsed["nAtoms"], strict=True)}


def _find_matching_metal(symbols: Collection[str], tissues: Mapping[str, Tissue]) -> str | None:
    """Find a table metal that contains all metals of a formula, and whose main element is one of these metals."""
    for name, tissue in tissues.items():
        parts = tissue.composition or {}
        main = max(parts, key=lambda symbol: parts[symbol], default="")
        if main in set(symbols) - _NONMETALS and set(symbols) - _ALLOYED_NONMETALS <= parts.keys():
            return name
    return None


def _has_same_composition(material: Material, tissue: Tissue) -> bool:
    """Check whether a material has the composition of a metal in the table, within the tolerance."""
    held = {_element_symbol(z): 100 * part for z, part in material.elements}
    parts = tissue.composition or {}
    return all(
        abs(held.get(symbol, 0.0) - parts.get(symbol, 0.0)) <= _COMPOSITION_TOLERANCE_PERCENT
        for symbol in held.keys() | parts
    )


def _format_composition(tissue: Tissue) -> str:
    """Format the composition of a metal as text, in percent by mass."""
    return ", ".join(f"{symbol} {percent:g}" for symbol, percent in (tissue.composition or {}).items()) + " % by mass"


def _element_symbol(z: int) -> str:
    """Return the symbol of an element."""
    return str(xraylib.AtomicNumberToSymbol(z))
