"""Detector: what absorbs, blurs and reads, as `data/detector.toml` has it."""

from functools import cache

from .records import Record, record
from .tables import data


class Detector(Record, frozen=True):
    """A scintillator on a readout.

    formula, density     of what absorbs, g/cm3
    thickness_mm         of the layer, of which `packing` is scintillator
    mtf_*, ntf_*         1 / (1 + (f / f0)^power) for the signal and for quantum noise, f0 in 1/mm
    swank                Swank factor (1973)
    electrons_per_kev    gain
    readout_electrons    rms a pixel
    electrons_per_dn_mm2 a square millimetre of pixel
    offset_dn            of a pixel that nothing reaches
    dead_seed            of the places of its dead pixels
    """

    formula: str
    density: float
    thickness_mm: float
    packing: float
    mtf_f0_per_mm: float
    mtf_power: float
    ntf_f0_per_mm: float
    ntf_power: float
    swank: float
    electrons_per_kev: float
    readout_electrons: float
    electrons_per_dn_mm2: float
    offset_dn: float
    dead_seed: int

    @property
    def mg_per_cm2(self) -> float:
        """Mass of scintillator a square centimetre."""
        return self.density * self.packing * self.thickness_mm * 100.0


@cache
def detectors() -> dict[str, Detector]:
    """Name -> detector, of all that the package has."""
    return record(dict[str, Detector], data("detector"), "detector")
